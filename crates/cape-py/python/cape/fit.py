"""Bodies and clothing fitted to images and scans.

Each function runs a command of the program in a process of its own. ``model`` is a :class:`cape.Model`, the
directory of a run or a model file, or None for the built-in model; ``outfit="auto"`` fits all of its
outfits and keeps the one of lowest energy.
"""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape, _program
from ._arrays import floats, real
from ._program import PathLike, Report
from .mesh import Mesh
from .model import Model, run_path

if TYPE_CHECKING:
    from typing_extensions import TypeIs

__all__ = ["Fit", "benchmark_image", "benchmark_scan", "garment", "image", "images", "pose_prior", "scan"]


@dataclass(frozen=True, eq=False)
class Fit:
    """Body and clothing fitted to an image or a scan; in a notebook it shows itself."""

    #: Vertices of the clothed body [V, 3], metres: in front of the camera, y up, or as the scan.
    vertices: NDArray[np.float32]
    #: Vertices of the body under the clothing [V, 3], metres.
    bare: NDArray[np.float32]
    #: Triangles [F, 3].
    faces: NDArray[np.uint32]
    #: Colours of the clothed body, sRGB from 0 to 1, [V, 3].
    colours: NDArray[np.float32]
    #: Pose in axis-angle, radians, [72].
    pose: NDArray[np.float32]
    #: Shape coefficients [b].
    betas: NDArray[np.float32]
    #: Translation [3], metres.
    transl: NDArray[np.float32]
    #: Latent code [latent].
    code: NDArray[np.float32]
    #: Outfit.
    outfit: str
    #: Reason for which the fit is unreliable, or None.
    problem: str | None
    #: Everything that the program reports: energies, errors, times.
    report: Report = field(repr=False)
    #: Picture of the input and the fit, PNG.
    picture: bytes = field(repr=False)

    def mesh(self) -> Mesh:
        """Mesh of the clothed body with its colours."""
        return Mesh(self.vertices, self.faces, self.colours)

    def _repr_png_(self) -> bytes:
        return self.picture

    def _repr_html_(self) -> str:
        return self.mesh()._repr_html_()


def image(
    model: Model | PathLike | None,
    keypoints: PathLike | ArrayLike,
    mask: PathLike | ArrayLike | None = None,
    out: PathLike | None = None,
    *,
    labels: Sequence[int | str] | None = None,
    occluders: PathLike | ArrayLike | None = None,
    image_size: tuple[int, int] | None = None,
    image: PathLike | None = None,
    outfit: str = "auto",
    compare_outfits: bool = False,
    layout: str | None = None,
    image_id: str | int | None = None,
    person: int | None = None,
    focal: float | None = None,
    config: PathLike | None = None,
    pose_prior: PathLike | None = None,
    silhouette: Literal["distance", "soft"] | None = None,
    threads: int | None = None,
) -> Fit:
    """Fit a clothed body to 2D keypoints and a silhouette.

    - ``keypoints``: file of a pose estimator, or array [k, 3] of x, y in pixels and confidence
    - ``mask``: silhouette of the person, file or array [height, width], with ``labels`` of a label image;
      ``occluders``: what hides the person, alike
    - ``out``: directory for the files of ``cape fit image``; none are kept if it is left out
    - ``image_size``: width and height in pixels, if neither ``mask`` nor ``image``, the photograph, tells
    - ``layout`` of the keypoints, ``image_id`` and ``person`` in files of several
    - ``focal``: focal length in pixels, the image's diagonal if left out
    - ``config``, ``pose_prior``, ``silhouette``, ``compare_outfits``: see ``cape fit image --help``

    A fit that is judged unreliable has a ``problem``, and warns.
    """
    given: dict[str, Any] = dict(locals())
    given.update(model=run_path(model), image_size=image_size and "x".join(map(str, image_size)))
    with _files(out) as (folder, write):
        if not _is_path(keypoints):
            given["keypoints"] = write("keypoints.npz", keypoints=_keypoints(keypoints))
        for name in ("mask", "occluders"):
            if given[name] is not None and not _is_path(given[name]):
                given[name] = write(f"{name}.npy", _mask(name, given[name]))
        return _fit("fit image", {**given, "out": folder}, model, "overlay.png", "model", "keypoints")


def images(
    model: Model | PathLike | None,
    keypoints: PathLike,
    out: PathLike,
    *,
    masks: PathLike | None = None,
    images: PathLike | None = None,
    sequence: bool = False,
    fps: float | None = None,
    labels: Sequence[int | str] | None = None,
    occluders: PathLike | None = None,
    image_size: tuple[int, int] | None = None,
    outfit: str = "auto",
    compare_outfits: bool = False,
    layout: str | None = None,
    person: int | None = None,
    focal: float | None = None,
    config: PathLike | None = None,
    pose_prior: PathLike | None = None,
    silhouette: Literal["distance", "soft"] | None = None,
    threads: int | None = None,
) -> Report:
    """Fit clothed bodies to the images of directories, each into a directory of ``out``; resumes.

    Files of one name in ``keypoints``, ``masks`` and ``images`` belong together. With ``sequence`` they are
    the frames of a video, ``fps`` per second (30): one shape, one outfit, one code and a smooth motion.
    The others are those of :func:`image`.
    """
    given: dict[str, Any] = dict(locals())
    given.update(model=run_path(model), image_size=image_size and "x".join(map(str, image_size)))
    return _program.run("fit image", given, "model")


def scan(
    model: Model | PathLike | None,
    scan: PathLike | ArrayLike | Mesh | Any,
    out: PathLike | None = None,
    *,
    outfit: str = "auto",
    unit: Literal["auto", "m", "cm", "mm"] = "m",
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = "y",
    pose: str | None = None,
    joints: PathLike | ArrayLike | None = None,
    initial: PathLike | None = None,
    minimal_shape: PathLike | ArrayLike | None = None,
    pose_prior: PathLike | None = None,
    free_displacement: bool = False,
    smooth: float | None = None,
    raw: PathLike | None = None,
    subject: str = "subject",
    sequence: str = "scan",
    frame: int = 1,
    seed: int | None = None,
    threads: int | None = None,
) -> Fit:
    """Fit a clothed body to a scan, a point cloud or mesh with holes and noise.

    - ``scan``: file, points [n, 3], or mesh: of cape, trimesh or meshio, or a pair of vertices and faces
    - ``out``: directory for the files of ``cape fit scan``; none are kept if it is left out
    - ``unit`` and ``up`` axis of the scan
    - one of ``pose``, name or file of an approximate pose; ``joints``, [24, 3] in the scan's unit, NaN
      where unknown; ``initial``, file of an approximate body
    - ``minimal_shape``: body of the subject [V, 3], metres, which keeps the shape fixed
    - ``free_displacement`` then moves every vertex to the scan, ``smooth`` being the weight of smoothness,
      and writes a registration to the raw tree ``raw`` as ``frame`` of ``subject`` and ``sequence``

    A fit that is judged unreliable has a ``problem``, and warns.
    """
    given: dict[str, Any] = dict(locals())
    given["model"] = run_path(model)
    with _files(out) as (folder, write):
        if not _is_path(scan):
            given["scan"] = write("scan.ply", _scan(scan))
        if joints is not None and not _is_path(joints):
            given["joints"] = write("joints.npy", floats("joints", joints).astype(np.float64))
        if minimal_shape is not None and not _is_path(minimal_shape):
            given["minimal_shape"] = write("minimal.npy", real("minimal_shape", minimal_shape))
        return _fit("fit scan", {**given, "out": folder}, model, "fit.png", "model")


def garment(
    garment: PathLike | Mesh | Any,
    scan: PathLike,
    out: PathLike,
    *,
    unit: Literal["m", "cm", "mm"] = "m",
    dressed: bool = False,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Lay the mesh of a ``garment`` onto each ``scan`` of a directory, frame by frame.

    The garment is a file or mesh in the ``unit`` of the scans, near its place in the first one. ``out`` receives
    a mesh with its triangles for each scan, metres, and a picture; :func:`cape.layer.import_` takes it.
    ``dressed`` scans are of the whole person.
    """
    given: dict[str, Any] = dict(locals())
    with _files(out) as (_, write):
        if not _is_path(garment):
            given["garment"] = write("garment.ply", Mesh.of(garment))
        return _program.run("fit scan", given)


def pose_prior(
    *sources: PathLike,
    out: PathLike,
    components: int = 8,
    poses: int = 20_000,
    floor: float | None = None,
    threads: int | None = None,
) -> Report:
    """Fit a pose prior of ``components`` Gaussians to at most ``poses`` of motions, directories of motions or
    packed sets, and write it to ``out``, ``.npz``; ``floor`` regularises variances, as a share."""
    given: dict[str, Any] = {**locals(), "sources": list(sources)}
    return _program.run("fit pose-prior", given, "sources")


def benchmark_image(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    data: PathLike | None = None,
    overwrite: bool = False,
    frames: int = 120,
    tuning: bool = False,
    bodies: PathLike | None = None,
    size: int = 512,
    noise: float = 0.0,
    bias: float = 0.0,
    dropped: float = 0.0,
    ragged: float = 0.0,
    config: PathLike | None = None,
    pose_prior: PathLike | None = None,
    silhouette: Literal["distance", "soft"] | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Measure fits to images of held-out ``frames`` beside SMPLify (section 6.3 of the paper); resumes.

    ``data`` is a packed set, that of the run if left out; ``tuning`` takes other frames, to choose weights on;
    ``bodies`` are the subjects' minimal shapes, random ones if left out; ``size`` of the images, pixels;
    ``noise`` of the keypoints, pixels; ``bias`` of hips and neck, mm; shares of ``dropped`` keypoints and of
    ``ragged`` pixels at the outline; ``overwrite`` discards results of other settings. The others are those of
    :func:`image`.
    """
    return _program.run("fit benchmark image", {**locals(), "model": run_path(model)}, "model")


def benchmark_scan(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    data: PathLike | None = None,
    overwrite: bool = False,
    frames: int = 8,
    points: int = 20_000,
    noise: Sequence[float] = (0, 2, 5),
    holes: Sequence[float] = (0, 0.2),
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Measure fits to scans of held-out ``frames`` with noise and holes; resumes.

    ``data`` is a packed set, that of the run if left out; scans have ``points``, with each of the ``noise``
    deviations, mm, and each share of ``holes``; ``overwrite`` discards results of other settings.
    """
    return _program.run("fit benchmark scan", {**locals(), "model": run_path(model)}, "model")


def _fit(
    command: str,
    given: dict[str, Any],
    model: Model | PathLike | None,
    picture: str,
    *positional: str,
) -> Fit:
    folder = Path(given["out"])
    problem = None
    try:
        _program.run(command, given, *positional)
    except _cape.CapeError as error:
        if not (folder / "fit.json").is_file():
            raise
        problem = str(error).removeprefix("error: ")
        warnings.warn(problem, RuntimeWarning, stacklevel=3)
    report = json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    found = report.get("clothed") or report["fit"]
    parameters = found["parameters"]
    vertices, faces = _cape.load_mesh(folder / "clothed.ply")
    pose, betas, transl, code = (
        np.array(values, dtype=np.float32)
        for values in (parameters["pose"], parameters["betas"], parameters["transl"], found["code"])
    )
    if not isinstance(model, Model):
        model = Model.pretrained() if model is None else Model.load(model)
    worn = model.decode(code, found["outfit"], pose)[0]
    if found is report.get("clothed"):
        # The file has the fit before that of the clothing.
        bare = model.body.model.forward(betas[None], pose[None], transl[None])[0][0]
    else:
        bare = _cape.load_mesh(folder / "bare.ply")[0]
    return Fit(
        vertices=vertices,
        bare=bare,
        faces=faces,
        colours=model.colours(worn, found["outfit"]),
        pose=pose,
        betas=betas,
        transl=transl,
        code=code,
        outfit=found["outfit"],
        problem=problem,
        report=report,
        picture=(folder / picture).read_bytes(),
    )


class _Writer:
    """Arrays as files of a directory."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, name: str, array: Any = None, **arrays: Any) -> Path:
        path = self._folder / name
        if isinstance(array, Mesh):
            array.save(path)
        elif path.suffix == ".npz":
            np.savez(path, **arrays)
        else:
            np.save(path, array)
        return path


@contextmanager
def _files(out: PathLike | None) -> Iterator[tuple[Path, _Writer]]:
    """The directory of results, which is removed if it has no name, and a writer of inputs."""
    with tempfile.TemporaryDirectory() as place:
        yield Path(place) / "out" if out is None else Path(out), _Writer(Path(place))


def _is_path(value: object) -> TypeIs[PathLike]:
    return isinstance(value, (str, os.PathLike))


def _keypoints(values: Any) -> NDArray[np.float64]:
    array = real("keypoints", values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise _cape.CapeError(f"keypoints: shape {list(array.shape)}, expected [k, 3]")
    return array.astype(np.float64)


def _mask(name: str, values: Any) -> NDArray[np.uint8]:
    array = real(name, values)
    if array.ndim != 2 or array.size == 0:
        raise _cape.CapeError(f"{name}: shape {list(array.shape)}, expected [height, width]")
    return np.where(array > 0, 255, 0).astype(np.uint8)


def _scan(values: Any) -> Mesh:
    """A mesh, or points without triangles."""
    if hasattr(values, "faces") or hasattr(values, "cells_dict") or isinstance(values, tuple):
        return Mesh.of(values)
    return Mesh(values, np.zeros((0, 3), dtype=np.uint32))
