"""Data sets: synthetic captures, packing, checks, unposing, generated bodies.

Each function runs a command of the program in a process of its own and returns its result, that of
``--json``. Directories ``out`` must be empty or missing; :func:`pack` and :func:`generate` resume what was
interrupted. ``body`` is a built-in body (``male``, ``female``, ``neutral`` or ``sculpted``) or an SMPL file,
or, with ``gender``, the directory of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from . import _program
from ._options import Gender, Prior, Up
from ._program import PathLike, Report
from .model import Model, run_path

__all__ = ["generate", "inspect", "pack", "synth", "unpose"]


def synth(
    out: PathLike,
    *,
    subjects: int = 4,
    frames_per_sequence: int = 60,
    outfits: Sequence[str] | None = None,
    motions: Sequence[str] | None = None,
    clothes: Literal["procedural", "simulated"] = "procedural",
    takes: int | None = None,
    motion: PathLike | None = None,
    up: Up = "auto",
    person: str | None = None,
    resolution: float | None = None,
    noise: float | None = None,
    sliding: float | None = None,
    shard: str | None = None,
    dry_run: bool = False,
    body: PathLike | None = None,
    gender: Gender | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Create synthetic captures in the raw layout of the CAPE data set.

    ``outfits`` are the paper's four and ``motions`` all if left out. With ``clothes="simulated"`` garments
    are simulated over the moving body: ``takes`` of each motion, ``motion``, a file or directory of recorded
    ones besides, with its ``up`` axis and ``person``; ``resolution``, edges of the garments, mm (25);
    ``noise``, deviation of a registration error, mm (0); ``sliding`` along the skin, 0 to 1 (0.1); ``shard``,
    such as ``2/8``; ``dry_run`` estimates time and size.
    """
    return _program.run("data synth", locals())


def pack(
    raw: PathLike,
    out: PathLike,
    *,
    preset: Literal["male", "female"] | None = None,
    split: PathLike | None = None,
    mirror: bool = False,
    strict: bool = False,
    follow_links: bool = False,
    threads: int | None = None,
) -> Report:
    """Pack raw captures into the arrays for training; returns the numbers of frames and what is missing.

    ``preset`` takes the male or female subjects, ``split`` those of a file; ``mirror`` packs each training
    frame a second time with left and right exchanged; ``strict`` stops at the first unreadable frame;
    ``follow_links`` follows symbolic links out of ``raw``.
    """
    return _program.run("data pack", locals(), "raw")


def inspect(
    path: PathLike,
    *,
    frames: int = 3,
    clothing: PathLike | None = None,
    preset: Literal["male", "female"] | None = None,
    statistics: bool = False,
    reference: PathLike | None = None,
    reference_clothing: PathLike | None = None,
    body: PathLike | None = None,
    gender: Gender | None = None,
    threads: int | None = None,
) -> Report:
    """Check raw captures or a packed set; returns counts, magnitudes and warnings with remedies.

    ``frames`` are read of each capture; ``clothing`` are the clothing vertices, ``.npy``, if the set has
    none; ``preset`` compares raw data with the release's list; ``statistics`` measures how the clothing of a
    packed set varies, beside ``reference``, statistics of another, with its ``reference_clothing``.
    """
    return _program.run("data inspect", locals(), "path")


def unpose(
    raw: PathLike,
    out: PathLike,
    *,
    body: PathLike | None = None,
    gender: Gender | None = None,
    betas: int = 10,
    threads: int | None = None,
) -> Report:
    """Unpose registrations of your own for packing, and fit ``betas`` shape coefficients to the subjects."""
    return _program.run("data unpose", locals(), "raw")


def generate(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    n: int = 1000,
    poses: PathLike | None = None,
    up: Up = "auto",
    person: str | None = None,
    outfit: Sequence[str] | None = None,
    shape_deviation: float = 1.0,
    prior: Prior | None = None,
    temperature: float = 1.0,
    format: Literal["npz", "ply", "obj"] = "npz",
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Generate ``n`` dressed bodies of a model, or of the built-in one (None), as training data.

    ``poses``, a file, with its ``up`` axis and ``person``, stands for synthetic motions; ``outfit`` are
    those to choose from; ``shape_deviation`` is that of the shape coefficients; ``prior`` and
    ``temperature`` are of the latent codes. ``npz`` has 64 bodies in a file, metres.
    """
    return _program.run("data generate", {**locals(), "model": run_path(model)}, "model")
