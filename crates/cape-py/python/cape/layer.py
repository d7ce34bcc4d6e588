"""Clothing layers, meshes of their own over the body: simulated, imported, learned, predicted.

Each function runs a command of the program in a process of its own and returns its result, that of
``--json``. ``body`` is a built-in body (``male``, ``female``, ``neutral``, the default, or ``sculpted``) or an
SMPL file, or, with ``gender``, the directory of one.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _cape, _program
from ._options import Gender
from ._program import PathLike, Report
from .mesh import Mesh
from .model import Model
from .pictures import page

Garment = Literal["tshirt", "shorts", "skirt", "dress"]
#: Synthetic motions for layers.
Exercise = Literal["march", "squat", "swing", "jump", "walk"]
Standard = Literal["a-pose", "t-pose"]

__all__ = [
    "LayerMotion",
    "associate",
    "import_",
    "learn",
    "predict",
    "predict_random",
    "report",
    "synth",
    "transfer",
]

#: Frames that a notebook shows.
_SHOWN = 6


@dataclass(frozen=True, eq=False)
class LayerMotion:
    """Clothing of a layer over a motion; in a notebook some frames show themselves."""

    #: Vertices of the clothing in each frame [n, V, 3], metres.
    vertices: NDArray[np.float32]
    #: Triangles [F, 3].
    faces: NDArray[np.uint32]
    #: Semantic parameters by name.
    parameters: dict[str, float]
    #: Picture of some frames with the body, PNG.
    picture: bytes = field(repr=False)

    def __len__(self) -> int:
        return len(self.vertices)

    def mesh(self, index: int = 0) -> Mesh:
        """Mesh of a frame."""
        return Mesh(self.vertices[index], self.faces)

    def _repr_png_(self) -> bytes:
        return self.picture

    def _repr_html_(self) -> str:
        chosen = np.linspace(0, len(self) - 1, min(len(self), _SHOWN)).round().astype(int)
        return page([self.vertices[k] for k in chosen], self.faces, [None] * len(chosen))


def synth(
    out: PathLike,
    *,
    garment: Garment = "skirt",
    body: PathLike | None = None,
    gender: Gender | None = None,
    frames: int = 100,
    fps: float = 30.0,
    steps: int = 20,
    resolution: float = 25.0,
    hem: float = 20.0,
    cuffs: bool = False,
    exercises: Sequence[Exercise] | None = None,
    styles: int | None = None,
    subjects: Sequence[float] = (0.0,),
    lengths: Sequence[float] = (1.0,),
    widths: Sequence[float] = (1.0,),
    sleeves: Sequence[float] = (1.0,),
    stiffness: Sequence[float] = (1.0,),
    bending: Sequence[float] = (1.0,),
    masses: Sequence[float] = (1.0,),
    damping: Sequence[float] = (1.0,),
    friction: Sequence[float] = (1.0,),
    with_body: bool = False,
    threads: int | None = None,
) -> Report:
    """Simulate a garment over moving bodies, in all combinations of the given values; resumes.

    ``frames`` of a sequence at ``fps`` per second with ``steps`` of the simulation in each;
    ``resolution``, edges of the garment, and ``hem``, width of its hems, mm; ``cuffs`` adds elastic cuffs;
    ``exercises``, all if left out, or all synthetic motions in a number of random ``styles``;
    ``subjects``, first shape coefficients; ``lengths``, ``widths`` and ``sleeves`` relative to the
    garment's; ``stiffness``, ``bending``, ``masses``, ``damping`` and ``friction`` relative to cotton
    shirting; ``with_body`` appends the body's vertices to the meshes.
    """
    return _program.run("layer synth", locals())


def import_(
    meshes: PathLike,
    motion: PathLike | None = None,
    *,
    set: PathLike,
    name: str,
    parameters: Mapping[str, float] | None = None,
    topology: PathLike | None = None,
    files: str | None = None,
    unit: Literal["m", "cm", "mm"] = "m",
    up: Literal["y", "z", "-y"] | None = None,
    fps: float | None = None,
    mesh_fps: float | None = None,
    resample: float | None = None,
    person: str | None = None,
    body: PathLike | None = None,
    gender: Gender | None = None,
    threads: int | None = None,
) -> Report:
    """Import a captured or simulated clothing sequence into the ``set`` under a ``name``.

    ``meshes`` is a directory of meshes, whose names match ``files``, a point cache or array with the
    triangles of ``topology``, or an archive that has the ``motion`` as well. ``parameters`` are length,
    width, sleeve, size and those of the material. ``fps`` is the rate of the motion, ``mesh_fps`` that of the
    meshes and ``resample`` that of the result, frames per second.
    """
    return _program.run("layer import", locals(), "meshes", "motion")


def associate(
    set: PathLike,
    out: PathLike,
    *,
    body: PathLike | None = None,
    gender: Gender | None = None,
    neighbours: int = 4,
    sigma: float = 10.0,
    support: float = 30.0,
    frame: int = 0,
    standard: Standard = "a-pose",
    compare: Sequence[int] = (1, 2, 4, 16),
    shown: int | None = None,
    threads: int | None = None,
) -> Report:
    """Associate clothing vertices with ``neighbours`` body vertices each, and compare numbers of them.

    ``sigma``, deviation of the influence of a pair over the meshes, mm; ``support``, its largest distance,
    mm; ``frame`` of the association over all sequences; ``standard``, pose of unposed clothing; ``shown``,
    frame of the comparison.
    """
    return _program.run("layer associate", locals(), "set")


def learn(
    set: PathLike,
    out: PathLike,
    *,
    body: PathLike | None = None,
    gender: Gender | None = None,
    neighbours: int = 4,
    sigma: float = 10.0,
    support: float = 30.0,
    frame: int = 0,
    standard: Standard = "a-pose",
    components: int | None = None,
    patience: int | None = None,
    copies: int = 8,
    noise: float = 0.1,
    decay: float = 0.0,
    reduce: int = 4,
    wearer_ratios: bool = False,
    smoothing: float = 0.0,
    history: int = 0,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Learn ``components`` of a set of sequences and their regression; writes ``layer.npz`` to ``out``.

    The association is that of :func:`associate`. ``components``, 40 for one sequence and 100 for several if
    left out; ``patience``, rises of the validation error before training stops, otherwise the best of all
    iterations is kept; ``copies`` of the frames with ``noise`` on semantic parameters, relative to their
    deviation; ``decay``, weight of the network's mean squared parameters; ``reduce``, dimension of the
    semantic parameters; ``wearer_ratios``, garment sizes as ratios to the wearer, ``length_ratio`` and so on;
    ``smoothing`` of speeds, seconds; ``history``, earlier moments, 0.1 s apart, that the
    prediction depends on.
    """
    return _program.run("layer learn", locals(), "set")


def predict(
    layer: PathLike,
    out: PathLike | None = None,
    *,
    body: PathLike | None = None,
    gender: Gender | None = None,
    motion: PathLike = "walk",
    seconds: float = 2.0,
    fps: float | None = None,
    up: Literal["auto", "y", "z", "-y"] = "auto",
    person: str | None = None,
    betas: Sequence[float] | None = None,
    parameters: Mapping[str, float] | None = None,
    clearance: float = 2.0,
    format: Literal["ply", "obj"] = "ply",
    threads: int | None = None,
) -> LayerMotion:
    """Predict the clothing of ``layer.npz`` over a motion.

    ``motion`` is the name of a synthetic one, of ``seconds``, or a file, with its ``up`` axis and
    ``person``; ``fps``, frames per second; ``betas``, shape coefficients; ``parameters``, semantic ones by
    name, the others at their mean; ``clearance``, least distance from the body, mm. Meshes are kept in
    ``out`` if it is given, in ``format``.
    """
    return _motion("layer predict", locals(), "layer", "predicted.png")


def predict_random(
    layer: PathLike,
    random: int,
    out: PathLike | None = None,
    *,
    body: PathLike | None = None,
    gender: Gender | None = None,
    motion: PathLike = "walk",
    seconds: float = 2.0,
    fps: float | None = None,
    up: Literal["auto", "y", "z", "-y"] = "auto",
    person: str | None = None,
    betas: Sequence[float] | None = None,
    parameters: Mapping[str, float] | None = None,
    clearance: float = 2.0,
    format: Literal["ply", "obj"] = "ply",
    seed: int | None = None,
    threads: int | None = None,
) -> list[LayerMotion]:
    """Predict the clothing of ``layer.npz`` over a motion for a number of ``random`` semantic parameters.

    They are distributed as in the training sequences; those in ``parameters`` are the same in all draws, and
    another ``seed`` has other draws. The other arguments are those of :func:`predict`. The picture of every
    draw is that of all.
    """
    given = dict(locals())
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "draws" if out is None else Path(out)
        found = _program.run("layer predict", {**given, "out": folder}, "layer")
        shown = (folder / "random.png").read_bytes()
        return [
            LayerMotion(*_frames(Path(draw["directory"]), format), dict(draw["parameters"]), shown)
            for draw in found["random"]
        ]


def transfer(
    set: PathLike,
    out: PathLike | None = None,
    *,
    body: PathLike | None = None,
    gender: Gender | None = None,
    sequence: str | None = None,
    betas: Sequence[float] | None = None,
    neighbours: int = 4,
    sigma: float = 10.0,
    support: float = 30.0,
    frame: int = 0,
    standard: Standard = "a-pose",
    clearance: float = 2.0,
    format: Literal["ply", "obj"] = "ply",
    threads: int | None = None,
) -> LayerMotion:
    """Put the captured clothing of a ``sequence``, the first if left out, on a body with other ``betas``.

    The association is that of :func:`associate`; ``clearance``, least distance from the body, mm. Meshes are
    kept in ``out`` if it is given, in ``format``.
    """
    return _motion("layer transfer", locals(), "set", "transferred.png")


def _motion(command: str, given: Mapping[str, Any], source: str, picture: str) -> LayerMotion:
    """Clothing that a command writes frame by frame."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "frames" if given["out"] is None else Path(given["out"])
        found = _program.run(command, {**given, "out": folder}, source)
        vertices, faces = _frames(folder, given["format"])
        shown = (folder / picture).read_bytes()
    return LayerMotion(vertices, faces, dict(found.get("parameters", ())), shown)


def _frames(folder: Path, format: str) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices and triangles of the meshes of a directory."""
    meshes = [_cape.load_mesh(path) for path in sorted(folder.glob(f"frame-*.{format}"))]
    return np.stack([vertices for vertices, _ in meshes]), meshes[0][1]


def report(
    *sets: PathLike,
    out: PathLike,
    overwrite: bool = False,
    quick: bool = False,
    garment: Garment | None = None,
    frames: int | None = None,
    resolution: float | None = None,
    styles: int | None = None,
    trainings: int | None = None,
    body: PathLike | None = None,
    gender: Gender | None = None,
    cape: Model | PathLike | None = None,
    data: PathLike | None = None,
    neighbours: int = 4,
    sigma: float = 10.0,
    support: float = 30.0,
    frame: int = 0,
    standard: Standard = "a-pose",
    components: int | None = None,
    patience: int | None = None,
    copies: int = 8,
    noise: float = 0.1,
    decay: float = 0.0,
    reduce: int = 4,
    wearer_ratios: bool = False,
    smoothing: float = 0.0,
    history: int = 0,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """The experiments of the paper on ``sets`` or, without any, on a simulated garment; resumes.

    ``quick`` simulates few short sequences, otherwise ``garment``, ``frames`` of a sequence and
    ``resolution``, mm, and random ``styles`` of motions; ``trainings`` whose errors are averaged; ``cape``,
    a run to compare with on the test frames of ``data``; ``overwrite``
    discards results of other settings. The others are those of :func:`learn`.
    """
    given = dict(locals())
    if isinstance(cape, Model):
        given["cape"] = cape.path
    return _program.run("layer report", {**given, "sets": list(sets)}, "sets")
