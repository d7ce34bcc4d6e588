"""Mesh pyramids as SciPy matrices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


class MeshPyramid:
    """Mesh, its levels of ceil(V / factor) vertices, and the matrices between them."""

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, factors: Sequence[float]) -> None:
        triangles = np.asarray(faces)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < 2**32:
            raise _cape.CapeError("faces: expected vertex indices from 0")
        self._pyramid = _cape.MeshPyramid(
            np.asarray(vertices, dtype=np.float64),
            triangles.astype(np.uint32),
            [float(factor) for factor in factors],
        )

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


def _csr(parts) -> csr_matrix:
    from scipy.sparse import csr_matrix

    data, indices, starts, shape = parts
    return csr_matrix((data, indices, starts), shape=shape)
