"""Commands of the program that write pictures, meshes and animations, or describe files.

Each function runs a command in a process of its own and returns its result, that of ``--json``. ``model`` is
a :class:`cape.Model`, the directory of a run or a model file, or None for the built-in model. Directories
``out`` must be empty or missing. Poses and motions are names or files, with their ``up`` axis and
``person``; ``prior`` and ``temperature`` are of the latent codes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from . import _program
from ._options import Prior, Up
from ._program import PathLike, Report
from .model import Model, run_path

#: What varies from left to right.
Factor = Literal["code", "pose", "outfit", "shape", "direction", "between", "walk", "sum"]


def info(path: PathLike) -> Report:
    """Describe a file, a directory or a built-in body: what it is, its sizes and settings."""
    return _program.run("info", locals(), "path")


def demo(
    out: PathLike = "demo",
    *,
    minutes: float = 5.0,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Create data, train a narrow model, evaluate and sample it, within about so many ``minutes``.

    An earlier demonstration in ``out`` is replaced.
    """
    return _program.run("demo", locals())


def sample(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    outfit: str = "all",
    pose: PathLike = "a-pose",
    up: Up = "auto",
    person: str | None = None,
    betas: Sequence[float] | None = None,
    n: int = 1,
    prior: Prior | None = None,
    temperature: float = 1.0,
    format: Literal["obj", "ply", "glb", "usda", "smpl"] = "obj",
    name: str = "{outfit}_{sample}",
    colours: Literal["cloth", "displacement"] = "cloth",
    scale: float = 50.0,
    uv: PathLike | None = None,
    texture: PathLike | None = None,
    fps: float | None = None,
    shape_targets: int = 0,
    no_picture: bool = False,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Write ``n`` samples of clothing on posed bodies as meshes; :meth:`cape.Model.sample` returns arrays.

    ``outfit`` is one or ``all``; ``pose`` a name or a file of poses, of which ``glb`` and ``usda`` make an
    animation of ``fps`` per second; ``name`` a template of ``{outfit}``, ``{sample}``, ``{frame}``, ``{pose}``
    and ``{seed}``; ``colours`` those of cloth and skin, or of the displacement, ``scale`` mm the brightest;
    ``uv`` a file with texture coordinates and ``texture`` a picture; ``shape_targets`` shape directions as morph
    targets of ``glb``. ``no_picture`` leaves out ``contact_sheet.png``.
    """
    return _program.run("sample", {**locals(), "model": run_path(model)}, "model")


def vary(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    by: Factor = "code",
    columns: int = 6,
    rows: int = 1,
    codes: Sequence[str] | None = None,
    sum: str | None = None,
    pose: PathLike = "a-pose",
    motion: PathLike = "walk",
    up: Up = "auto",
    person: str | None = None,
    outfit: str | None = None,
    betas: Sequence[float] | None = None,
    prior: Prior | None = None,
    temperature: float = 1.0,
    same_code: bool = False,
    no_meshes: bool = False,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Vary one factor while the rest is fixed (figures 1, 5 and 6 of the paper); a picture and meshes.

    ``columns`` bodies in each of ``rows``, each row of another code; ``codes`` are ``mean``, ``seed:N``,
    ``frame:K``, ``FILE.npy:ROW`` or ``samples.jsonl:ROW``, ``sum`` such as ``frame:3 - frame:10 + seed:1``.
    Under another outfit a code is moved to its place among that outfit's codes, unless ``same_code``.
    ``no_meshes`` writes the picture only.
    """
    return _program.run("vary", {**locals(), "model": run_path(model)}, "model")


def redress(
    model: Model | PathLike | None,
    registration: PathLike,
    out: PathLike,
    *,
    was: str | None = None,
    minimal: PathLike | None = None,
    outfit: Sequence[str] | None = None,
    pose: Sequence[PathLike] | None = None,
    up: Up = "auto",
    person: str | None = None,
    to: Sequence[PathLike | Sequence[float]] | None = None,
    exact: bool = False,
    same_code: bool = False,
    threads: int | None = None,
) -> Report:
    """Change ``outfit`` and ``pose`` of a registration, or put its clothing on other bodies.

    ``registration`` is a frame, or ``frame:K`` for a test frame of the run; ``was`` its outfit, ``minimal`` its
    body [V, 3], ``.npy``, if its place does not tell; ``to`` other bodies: shape coefficients, minimal shapes or
    registrations, with the registered displacements if ``exact``. For another outfit the code is moved to its place among
    that outfit's codes, unless ``same_code``.
    """
    given: dict[str, Any] = {**locals(), "model": run_path(model)}
    if to is not None:
        given["to"] = _program.Repeated(to)
    return _program.run("redress", given, "model", "registration")


def animate(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    motion: PathLike = "walk",
    up: Up = "auto",
    person: str | None = None,
    seconds: float = 2.0,
    fps: float | None = None,
    outfit: str | None = None,
    betas: Sequence[float] | None = None,
    code: str | None = None,
    prior: Prior | None = None,
    temperature: float = 1.0,
    format: Literal["png", "glb", "usda", "pc2", "mdd", "smpl", "obj", "ply"] = "png",
    tolerance: float | None = None,
    every: int | None = None,
    size: int = 512,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Animate a dressed body by a motion with one latent code.

    ``seconds`` of a synthetic motion, ``fps`` frames per second; ``code`` as in :func:`vary`; ``tolerance``,
    largest error of a vertex in ``glb`` and ``usda``, mm (1), or ``every`` so many frames with their vertices;
    ``size`` of pictures, pixels.
    """
    return _program.run("animate", {**locals(), "model": run_path(model)}, "model")


def export_view(
    model: Model | PathLike | None,
    site: PathLike,
    *,
    motion: PathLike | None = None,
    up: Up = "auto",
    person: str | None = None,
    registrations: int = 0,
    threads: int | None = None,
) -> Report:
    """Write the viewer of a model as a folder ``site``, empty or missing, that needs no server.

    The folder contains the body: SMPL's licence does not allow passing on SMPL. ``motion`` is a file of a motion
    to offer beside the synthetic ones, ``registrations`` the number of held-out registrations to put in; the
    licence of the CAPE data does not allow passing them on.
    """
    given = {**locals(), "model": run_path(model), "export": site}
    del given["site"]
    return _program.run("view", given, "model")
