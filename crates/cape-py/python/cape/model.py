"""Trained clothing models."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape
from .body import Body, _matrix, _repeat


@dataclass(frozen=True)
class Dressed:
    """Clothed bodies.

    ``vertices`` [n, V, 3], posed, and ``displacement`` [n, V, 3], in the rest pose, metres;
    ``codes`` [n, latent]; ``faces`` [F, 3].
    """

    vertices: NDArray[np.float32]
    displacement: NDArray[np.float32]
    codes: NDArray[np.float32]
    faces: NDArray[np.uint32]


class Model:
    """Trained clothing model, of a run of ``cape train``, a model file, or built in."""

    def __init__(self, model: _cape.Model) -> None:
        self._model = model
        #: Number of latent dimensions.
        self.latent: int = model.latent
        #: Names of the outfits.
        self.outfits: list[str] = model.outfits
        #: Indices of the vertices that clothing covers.
        self.clothing: NDArray[np.int64] = model.clothing
        #: Unclothed body.
        self.body = Body(model.body())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Model:
        """Open the directory of a run or a model file."""
        return cls(_cape.Model.load(Path(path)))

    @classmethod
    def pretrained(cls) -> Model:
        """Return the built-in model."""
        return cls(_cape.Model.pretrained())

    def sample(
        self,
        outfit: str,
        n: int = 1,
        pose: ArrayLike | None = None,
        betas: ArrayLike | None = None,
        seed: int = 1,
        temperature: float = 1.0,
    ) -> Dressed:
        """Dress bodies in ``n`` samples of clothing of an outfit.

        ``pose`` [72] or [n, 72], axis-angle, radians; ``betas`` [b] or [n, b]; zero if left out.
        """
        return self.dress(self._model.sample(outfit, n, temperature, seed), outfit, pose, betas)

    def dress(
        self,
        codes: ArrayLike,
        outfit: str | Sequence[str],
        pose: ArrayLike | None = None,
        betas: ArrayLike | None = None,
    ) -> Dressed:
        """Dress bodies in the clothing of ``codes`` [n, latent]."""
        codes_ = _matrix("codes", codes, self.latent)
        n = max(len(codes_), len(_matrix("pose", pose, 72)))
        codes_, pose_ = self._rows("codes", codes_, n), self._pose(pose, n)
        betas_ = self._rows("betas", _matrix("betas", betas, self.body.num_betas), n)
        displacement = self._model.decode(codes_, pose_, self._outfits(outfit, n))
        vertices = self._model.dress(displacement, betas_, pose_)
        return Dressed(vertices, displacement, codes_, self.body.faces)

    def decode(
        self, codes: ArrayLike, outfit: str | Sequence[str], pose: ArrayLike | None = None
    ) -> NDArray[np.float32]:
        """Decode ``codes`` [n, latent] to displacements [n, V, 3] in the rest pose, metres."""
        codes_ = _matrix("codes", codes, self.latent)
        n = max(len(codes_), len(_matrix("pose", pose, 72)))
        outfits = self._outfits(outfit, n)
        return self._model.decode(self._rows("codes", codes_, n), self._pose(pose, n), outfits)

    def encode(
        self, displacement: ArrayLike, outfit: str | Sequence[str], pose: ArrayLike | None = None
    ) -> NDArray[np.float32]:
        """Encode ``displacement`` [n, V, 3], in the rest pose, metres, to codes [n, latent]."""
        points = self.body._points("displacement", displacement)
        n = len(points)
        return self._model.encode(points, self._pose(pose, n), self._outfits(outfit, n))

    def interpolate(self, first: ArrayLike, last: ArrayLike, n: int) -> NDArray[np.float32]:
        """Codes [n, latent] on the line from one code to another."""
        a, b = (_matrix(name, code, self.latent) for name, code in (("first", first), ("last", last)))
        share = np.linspace(0, 1, n, dtype=np.float32)[:, None]
        return (1 - share) * a[:1] + share * b[:1]

    def _pose(self, pose: ArrayLike | None, n: int) -> NDArray[np.float32]:
        return self._rows("pose", _matrix("pose", pose, 72), n)

    @staticmethod
    def _rows(name: str, array: NDArray[np.float32], n: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(_repeat(name, array, n))

    @staticmethod
    def _outfits(outfit: str | Sequence[str], n: int) -> list[str]:
        return [outfit] * n if isinstance(outfit, str) else list(outfit)
