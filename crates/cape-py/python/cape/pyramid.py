"""Mesh pyramids as SciPy matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape
from ._arrays import real

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from ._cape import _Rows


class MeshPyramid:
    """Mesh, its levels of ceil(V / factor) vertices, and the matrices between them.

    ``vertices`` [V, 3] and ``faces`` [F, 3] are those of the finest level; each of ``factors`` is
    relative to the level before.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, factors: Sequence[float]) -> None:
        points = real("vertices", vertices).astype(np.float64, copy=False)
        triangles = real("faces", faces)
        steps = real("factors", factors).astype(np.float64).reshape(-1).tolist()
        if triangles.dtype.kind not in "iu" or (
            triangles.size and not 0 <= triangles.min() <= triangles.max() < 2**32
        ):
            raise _cape.CapeError("faces: expected vertex indices, integers from 0")
        for name, array in (("vertices", points), ("faces", triangles)):
            if array.ndim != 2 or array.shape[1] != 3:
                raise _cape.CapeError(f"{name}: shape {list(array.shape)}, expected [n, 3]")
        self._pyramid = _cape.MeshPyramid(points, triangles.astype(np.uint32), steps)

    def __len__(self) -> int:
        return len(self._pyramid)

    def level(self, index: int) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
        """Vertices [V, 3] and faces [F, 3] of a level; 0 is the finest."""
        return self._pyramid.level(index)

    def laplacian(self, index: int) -> csr_matrix:
        """Rescaled Laplacian of a level, [V, V]."""
        return _csr(self._pyramid.laplacian(index))

    def down(self, index: int) -> csr_matrix:
        """Matrix from level ``index`` to the next coarser one."""
        return _csr(self._pyramid.down(index))

    def up(self, index: int) -> csr_matrix:
        """Matrix to level ``index`` from the next coarser one."""
        return _csr(self._pyramid.up(index))


def _csr(parts: _Rows) -> csr_matrix:
    from scipy.sparse import csr_matrix

    data, indices, starts, shape = parts
    return csr_matrix((data, indices, starts), shape=shape)
