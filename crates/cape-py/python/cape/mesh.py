"""Triangle meshes, which notebooks show, and which trimesh and meshio take."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape
from ._arrays import floats, real
from .pictures import bytes_of, draw, page

if TYPE_CHECKING:
    import meshio
    import trimesh


class Mesh:
    """Triangle mesh; in a notebook it shows itself and is turned by the mouse.

    ``vertices`` [V, 3], metres, float32; ``faces`` [F, 3], vertex indices, uint32; ``colours`` [V, 3],
    sRGB from 0 to 1, float32, or None.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, colours: ArrayLike | None = None) -> None:
        self.vertices: NDArray[np.float32] = _triples("vertices", floats("vertices", vertices))
        self.faces: NDArray[np.uint32] = triangles(faces, len(self.vertices))
        self.colours: NDArray[np.float32] | None = None
        if not np.isfinite(self.vertices).all():
            raise _cape.CapeError("vertices: not finite")
        if colours is not None:
            self.colours = _triples("colours", floats("colours", colours))
            if len(self.colours) != len(self.vertices):
                raise _cape.CapeError(f"colours: {len(self.colours)} rows, expected {len(self.vertices)}")
            if not ((self.colours >= 0) & (self.colours <= 1)).all():
                raise _cape.CapeError("colours: expected numbers from 0 to 1")

    @classmethod
    def of(cls, mesh: Any) -> Mesh:
        """Return the mesh of an object with ``vertices`` and ``faces``, such as ``trimesh.Trimesh``, of
        ``meshio.Mesh``, or of a pair of arrays; colours of vertices are kept."""
        if isinstance(mesh, Mesh):
            return mesh
        if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
            visual: Any = getattr(mesh, "visual", None)
            colours = None
            if getattr(visual, "kind", None) == "vertex":
                colours = np.asarray(visual.vertex_colors)[:, :3] / np.float32(255)
            return cls(mesh.vertices, mesh.faces, colours)
        if hasattr(mesh, "points") and hasattr(mesh, "cells_dict"):
            given = mesh.point_data
            channels = [given.get(name) for name in ("red", "green", "blue")]
            colours = None
            if all(channel is not None for channel in channels):
                # meshio reads bytes of PLY files as numbers with a sign.
                bytes_ = [np.asarray(channel).astype(np.uint8) for channel in channels]
                colours = np.stack(bytes_, axis=1) / np.float32(255)
            if "triangle" not in mesh.cells_dict:
                raise _cape.CapeError(f"mesh: cells {list(mesh.cells_dict)}, expected `triangle`")
            return cls(mesh.points, mesh.cells_dict["triangle"], colours)
        if isinstance(mesh, (tuple, list)) and len(mesh) == 2:
            return cls(*mesh)
        raise _cape.CapeError(f"mesh: {type(mesh).__name__}, expected one with `vertices` and `faces`")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Mesh:
        """Read the vertices and faces of an OBJ, PLY, STL, OFF or ``.glb`` file."""
        return cls(*_cape.load_mesh(Path(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh as ``.ply``, with its colours, or ``.obj``, or its picture as ``.png``."""
        path = Path(path)
        if path.suffix.lower() == ".png":
            path.write_bytes(self._repr_png_())
        else:
            colours = None if self.colours is None else bytes_of(self.colours)
            _cape.save_mesh(path, self.vertices, self.faces, colours)

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return the mesh as ``trimesh.Trimesh``, its vertices as they are, with its colours."""
        import trimesh

        colours = None if self.colours is None else bytes_of(self.colours)
        return trimesh.Trimesh(self.vertices, self.faces, vertex_colors=colours, process=False)

    def to_meshio(self) -> meshio.Mesh:
        """Return the mesh as ``meshio.Mesh``, with its colours as ``red``, ``green`` and ``blue``."""
        import meshio

        data = {}
        if self.colours is not None:
            data = dict(zip(("red", "green", "blue"), bytes_of(self.colours).T.copy()))
        return meshio.Mesh(self.vertices, [("triangle", self.faces)], point_data=data)

    def picture(self, size: tuple[int, int] = (320, 420)) -> NDArray[np.uint8]:
        """Draw the mesh: pixels [height, width, 4], RGBA; ``size`` is width and height."""
        return draw([self.vertices], self.faces, [self.colours], size)

    def __repr__(self) -> str:
        return f"<cape.Mesh: {len(self.vertices)} vertices, {len(self.faces)} faces>"

    def _repr_png_(self) -> bytes:
        return _cape.encode_png(self.picture())

    def _repr_html_(self) -> str:
        return page([self.vertices], self.faces, [self.colours])


def triangles(faces: ArrayLike, vertices: int) -> NDArray[np.uint32]:
    """Vertex indices [F, 3] of triangles of a number of vertices."""
    array = real("faces", faces)
    if array.dtype.kind not in "iu" and array.size:
        raise _cape.CapeError(f"faces: numbers of type {array.dtype}, expected integers")
    if array.size and not 0 <= array.min() <= array.max() < vertices:
        found = f"{array.min()} to {array.max()}"
        raise _cape.CapeError(f"faces: vertices {found}, but there are {vertices} vertices")
    return _triples("faces", array.astype(np.uint32, copy=False))


def _triples(name: str, array: NDArray[Any]) -> NDArray[Any]:
    if array.ndim != 2 or array.shape[1] != 3 or (len(array) == 0 and name != "faces"):
        raise _cape.CapeError(f"{name}: shape {list(array.shape)}, expected [n, 3]")
    return array
