"""SMPL bodies with the argument names and shapes of smplx."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._cape import CapeError, FileError, SmplModel

_GENDERS = ("male", "female", "neutral")


@dataclass(frozen=True)
class BodyOutput:
    """Posed bodies: ``vertices`` [n, V, 3] and ``joints`` [n, J, 3], metres."""

    vertices: NDArray[np.float32]
    joints: NDArray[np.float32]


class Body:
    """SMPL body; calling it poses a batch. A batch of one is repeated to the others' size."""

    def __init__(self, model: SmplModel, num_betas: int | None = None) -> None:
        self.model = model
        #: Triangles, [F, 3].
        self.faces: NDArray[np.uint32] = model.faces
        available = model.shapedirs.shape[2]
        #: Number of shape coefficients.
        self.num_betas = available if num_betas is None else min(num_betas, available)
        self._joints = len(model.parents)
        self._vertices = model.v_template.shape[0]

    def __call__(
        self,
        betas: ArrayLike | None = None,
        body_pose: ArrayLike | None = None,
        global_orient: ArrayLike | None = None,
        transl: ArrayLike | None = None,
        displacement: ArrayLike | None = None,
    ) -> BodyOutput:
        """Pose bodies.

        ``betas`` [n, num_betas]; ``body_pose`` [n, 69] and ``global_orient`` [n, 3], axis-angle,
        radians; ``transl`` [n, 3], metres; ``displacement`` [n, V, 3], clothing in the rest pose,
        metres. What is left out is zero.
        """
        extra = None if displacement is None else self._points("displacement", displacement)
        n, betas_, pose, transl_ = self._parameters(
            betas, body_pose, global_orient, transl, 1 if extra is None else len(extra)
        )
        if extra is not None:
            extra = _repeat("displacement", extra, n)
        return BodyOutput(*self.model.forward(betas_, pose, transl_, extra))

    def unpose(
        self,
        vertices: ArrayLike,
        betas: ArrayLike | None = None,
        body_pose: ArrayLike | None = None,
        global_orient: ArrayLike | None = None,
        transl: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Bring posed ``vertices`` [n, V, 3] to the rest pose, without pose blend shapes, metres."""
        posed = self._points("vertices", vertices)
        n, betas_, pose, transl_ = self._parameters(
            betas, body_pose, global_orient, transl, len(posed)
        )
        return self.model.unpose(_repeat("vertices", posed, n), betas_, pose, transl_)

    def _points(self, name: str, values: ArrayLike) -> NDArray[np.float32]:
        points = np.asarray(values, dtype=np.float32)
        if points.ndim == 2:
            points = points[None]
        if points.ndim != 3 or points.shape[1:] != (self._vertices, 3):
            raise CapeError(
                f"{name}: shape {list(points.shape)}, expected [n, {self._vertices}, 3]"
            )
        return points

    def _parameters(self, betas, body_pose, global_orient, transl, rows):
        widths = {
            "betas": (betas, self.num_betas),
            "body_pose": (body_pose, 3 * (self._joints - 1)),
            "global_orient": (global_orient, 3),
            "transl": (transl, 3),
        }
        arrays = {name: _matrix(name, *given) for name, given in widths.items()}
        n = max([rows, *(len(array) for array in arrays.values())])
        arrays = {name: _repeat(name, array, n) for name, array in arrays.items()}
        pose = np.concatenate([arrays["global_orient"], arrays["body_pose"]], axis=1)
        return n, arrays["betas"], pose, arrays["transl"]


def load_smpl(path: str | os.PathLike[str]) -> SmplModel:
    """Read an SMPL file, ``.pkl`` or ``.npz``, without chumpy; pickles are not run."""
    return SmplModel.load(Path(path))


def create(
    model_path: str | os.PathLike[str] | None = None,
    model_type: str = "smpl",
    gender: str = "neutral",
    num_betas: int = 10,
) -> Body:
    """Open a body of a folder laid out for smplx, of a file, or, without a path, a built-in one.

    In a folder, ``smpl/SMPL_GENDER`` and ``SMPL_GENDER`` are looked for with the endings ``.pkl``
    and ``.npz``.
    """
    if model_type != "smpl":
        raise CapeError(f"model_type `{model_type}`: expected `smpl`")
    if gender not in _GENDERS:
        raise CapeError(f"gender `{gender}`: expected male, female or neutral")
    if num_betas < 0:
        raise CapeError(f"num_betas {num_betas}: expected at least 0")
    if model_path is None:
        return Body(SmplModel.embedded(gender), num_betas)
    path = Path(model_path)
    if path.is_dir():
        path = _file_of(path, gender)
    return Body(load_smpl(path), num_betas)


def _file_of(folder: Path, gender: str) -> Path:
    names = [f"SMPL_{gender.upper()}{ending}" for ending in (".pkl", ".npz")]
    places = [place / name for place in (folder / "smpl", folder) for name in names]
    for place in places:
        if place.is_file():
            return place
    raise FileError(f"{folder}: no {gender} body, expected one of {', '.join(map(str, places))}")


def _matrix(name: str, values: ArrayLike | None, width: int) -> NDArray[np.float32]:
    if values is None:
        return np.zeros((1, width), dtype=np.float32)
    array = np.asarray(values, dtype=np.float32)
    if array.ndim == 1:
        array = array[None]
    if array.ndim == 3:
        array = array.reshape(len(array), array.shape[1] * array.shape[2])
    if array.ndim != 2 or array.shape[1] != width:
        raise CapeError(f"{name}: shape {list(array.shape)}, expected [n, {width}]")
    return array


def _repeat(name: str, array: NDArray[np.float32], n: int) -> NDArray[np.float32]:
    if len(array) == n:
        return array
    if len(array) != 1:
        raise CapeError(f"{name}: {len(array)} rows, expected 1 or {n}")
    return np.repeat(array, n, axis=0)
