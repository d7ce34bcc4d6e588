"""Dressed bodies: their arrays, pictures and files."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from . import _cape
from .mesh import Mesh
from .pictures import MOST, draw, page, write_png

if TYPE_CHECKING:
    from .model import Model


@dataclass(frozen=True, eq=False)
class Dressed:
    """Dressed bodies; in a notebook the first eight show themselves and are turned by the mouse."""

    #: Posed vertices [n, V, 3], metres.
    vertices: NDArray[np.float32]
    #: Displacements in the rest pose [n, V, 3], metres; zero where nothing is worn.
    displacement: NDArray[np.float32]
    #: Latent codes [n, latent].
    codes: NDArray[np.float32]
    #: Triangles [F, 3].
    faces: NDArray[np.uint32]
    #: Outfit of each body, n names.
    outfits: tuple[str, ...]
    _model: Model = field(repr=False)

    def __len__(self) -> int:
        return len(self.vertices)

    def colours(self, index: int = 0) -> NDArray[np.float32]:
        """Colours of skin, shirt and trousers of a body: sRGB from 0 to 1, [V, 3]."""
        return self._model.colours(self.displacement[index], self.outfits[index])

    def mesh(self, index: int = 0) -> Mesh:
        """Mesh of a body with its colours."""
        return Mesh(self.vertices[index], self.faces, self.colours(index))

    def picture(self, size: tuple[int, int] = (320, 420)) -> NDArray[np.uint8]:
        """Draw the bodies beside each other, at most eight: pixels [height, n width, 4], RGBA.

        ``size`` is width and height of one body's picture, pixels.
        """
        return draw(list(self.vertices), self.faces, self._colours(), size)

    def save(self, path: str | os.PathLike[str], index: int = 0) -> None:
        """Write the picture, ``.png``, or the mesh of one body, ``.ply`` with its colours or ``.obj``."""
        path = Path(path)
        if path.suffix.lower() == ".png":
            write_png(path, self.picture())
        else:
            self.mesh(index).save(path)

    def _repr_png_(self) -> bytes:
        return _cape.encode_png(self.picture())

    def _repr_html_(self) -> str:
        return page(list(self.vertices), self.faces, self._colours())

    def _colours(self) -> list[NDArray[np.float32]]:
        return [self.colours(index) for index in range(min(len(self), MOST))]
