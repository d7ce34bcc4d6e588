"""Trained models measured: errors, samples, the effect of the pose, speed, and the paper's table 2.

Each function runs a command of the program in a process of its own and returns its result, that of
``--json``; lengths in names that end in ``_mm`` are millimetres. ``model`` is a :class:`cape.Model`, the
directory of a run or a model file, or None for the built-in model. ``data`` is a packed set; where it may be
left out, it is the one that the run was trained on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from . import _program
from ._options import Gender, Preset, Prior, Up
from ._program import PathLike, Report
from .model import Model, run_path, run_paths

#: Rows of table 2.
Row = Literal[
    "mean",
    "pca",
    "coma-4",
    "coma-1",
    "cape",
    "cape-affine",
    "no-discriminator",
    "no-residual",
    "no-edge",
]

__all__ = ["compare", "pose", "run", "samples", "speed", "table2"]


def run(
    model: Model | PathLike | None,
    data: PathLike,
    *,
    posterior: Literal["sample", "mean"] = "sample",
    batch: int = 16,
    map: PathLike | None = None,
    scale: float | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Measure reconstruction errors on the test frames of ``data``, beside the mean displacement's.

    Errors are Euclidean, at clothing vertices; they are also written to ``eval.json`` of the run. Decoded is a
    sample of the ``posterior`` or its mean; ``batch`` frames at once; ``map``, ``.ply``, gets the body
    coloured by its mean errors, ``scale`` mm (20) the brightest.
    """
    return _program.run("eval run", {**locals(), "model": run_path(model)}, "model")


def compare(
    *runs: Model | PathLike,
    data: PathLike | None = None,
    out: PathLike | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Compare ``runs``, each with the first, on the same test frames.

    Errors with bootstrap intervals over captures, measures of wrinkles, and paired tests; as tables and
    histograms in the directory ``out`` if it is given.
    """
    given: dict[str, Any] = {**locals(), "runs": run_paths("runs", runs)}
    return _program.run("eval compare", given, "runs")


def samples(
    model: Model | PathLike | None,
    data: PathLike | None = None,
    *,
    prior: Prior | None = None,
    temperature: float = 1.0,
    frames: int = 200,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Measure coverage, fidelity and diversity of samples against at most ``frames`` held-out frames.

    Also written to ``samples.json`` of the run. ``prior`` and ``temperature`` are of the latent codes.
    """
    return _program.run("eval samples", {**locals(), "model": run_path(model)}, "model")


def pose(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    pose_a: PathLike = "a-pose",
    pose_b: PathLike = "squats",
    up: Up = "auto",
    person: str | None = None,
    outfit: str | None = None,
    prior: Prior | None = None,
    temperature: float = 1.0,
    scale: float = 20.0,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Measure how the pose changes the clothing of one code (figure 6 of the paper).

    Poses are names or files, with their ``up`` axis and ``person``. ``out``, empty or missing, gets
    ``pose_effect.json``, ``change.ply`` coloured by the change, ``scale`` mm the brightest, and
    ``pose_effect.png``.
    """
    return _program.run("eval pose", {**locals(), "model": run_path(model)}, "model")


def speed(
    *,
    batch: int = 16,
    preset: Preset = "paper",
    precision: Literal["f32", "bf16"] | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Measure seconds of a training step, of decoding and of encoding ``batch`` bodies on random data."""
    return _program.run("eval speed", locals())


def table2(
    out: PathLike,
    *,
    data: PathLike | None = None,
    overwrite: bool = False,
    quick: bool = False,
    rows: Sequence[Row] | None = None,
    seeds: int = 1,
    epochs: int | None = None,
    checkpoint_minutes: float | None = None,
    shard: str | None = None,
    tabulate: bool = False,
    dry_run: bool = False,
    config: PathLike | None = None,
    preset: Preset | None = None,
    precision: Literal["f32", "bf16"] | None = None,
    body: PathLike | None = None,
    gender: Gender | None = None,
    clothing: PathLike | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Train and evaluate the ``rows`` of the paper's table 2, all if left out, under one protocol; resumes.

    Tables and pictures are in ``out``. ``quick`` trains narrow models briefly, without ``data`` on synthetic
    captures; ``seeds`` of each row; ``shard``, such as ``2/8``, does a share of the jobs; ``tabulate`` trains
    nothing; ``dry_run`` estimates the time; ``overwrite`` discards results of other settings. The others are
    those of :func:`cape.train`.
    """
    return _program.run("table2", locals())
