"""Perceptual studies: generated clothing judged by people (section 6.2 of the paper).

Raters see two pictures side by side, one of a registration and one generated, and choose the one that they
take for real. ``study`` is the directory that :func:`make` writes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from . import _program
from ._options import Prior
from ._program import PathLike, Report
from .model import Model, run_path, run_paths

__all__ = ["Served", "export", "make", "score", "serve"]


class Served(_program.Server):
    """Server of a study. It ends by ``close()``, at the end of a ``with`` block, or with Python."""

    def __init__(self, given: dict[str, Any]) -> None:
        super().__init__("study serve", given, "study")
        #: Address of each rater's page, by the rater's name.
        self.links: dict[str, str] = {link["rater"]: link["url"] for link in self._result}

    def __repr__(self) -> str:
        return f"<cape.study.Served: {len(self.links)} raters>"


def make(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    data: PathLike | None = None,
    real: Model | PathLike | None = None,
    outfit: str | None = None,
    poses: int = 300,
    a_pose: int = 100,
    matched: int = 100,
    catches: int = 6,
    practice: int = 4,
    trials: int = 60,
    prior: Prior | None = None,
    temperature: float = 1.0,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Make the pictures and the design of a study in the directory ``out``, empty or missing.

    ``model`` is the one that is judged, None the built-in one; ``data`` the packed set of the registrations,
    that of the run if left out; ``real`` a run in their place. Numbers of pairs: of one ``outfit`` in various
    ``poses``, of each outfit in the A-pose, of the same outfit and pose (``matched``), obvious ones that test
    attention (``catches``) and for ``practice``; a rater sees ``trials`` of them. ``prior`` and
    ``temperature`` are of the latent codes.
    """
    given: dict[str, Any] = {**locals(), "model": run_path(model)}
    if real is not None:
        given["real"] = run_paths("real", [real])[0]
    return _program.run("study make", given, "model")


def serve(
    study: PathLike,
    *,
    raters: int = 10,
    port: int = 0,
    address: str | None = None,
    url: str | None = None,
    completion: str | None = None,
) -> Served:
    """Serve a study to raters, whose answers are written to ``answers.jsonl`` in its directory.

    ``port`` 0 is a free one of ``address``, this machine's if left out; ``url`` is the address by which
    raters reach it, ``completion`` the page to go to at the end.
    """
    return Served(locals())


def export(
    study: PathLike,
    out: PathLike | None = None,
    *,
    jatos: PathLike | None = None,
    raters: int = 200,
    completion: str | None = None,
    pipe: str | None = None,
) -> Report:
    """Write a study as a folder of jsPsych, ``out``, or as a package for JATOS, ``.jzip``.

    ``raters`` is the number of schedules, ``completion`` the page to go to at the end, ``pipe`` an experiment of
    DataPipe to send answers to.
    """
    return _program.run("study export", locals(), "study")


def score(
    study: PathLike,
    *,
    answers: PathLike | Sequence[PathLike] | None = None,
    catch_share: float = 0.75,
    fastest: float = 200.0,
    stand_in: bool = False,
    plan: int | None = None,
    expect: float | None = None,
    deviations: tuple[float, float] | None = None,
    latex: PathLike | None = None,
    csv: PathLike | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Share of generated pictures that raters took for real, by case and outfit, with 95 % intervals.

    ``answers`` are files, ``answers.jsonl`` of the study if left out. Raters count who answer ``catch_share`` of
    the obvious pairs rightly, answers that took at least ``fastest`` ms. ``stand_in`` scores a classifier of the
    pictures, for development. ``plan``, a number of raters, estimates their precision, for the share ``expect``
    and ``deviations`` between raters and between pairs. Tables go to ``latex`` and ``csv``.
    """
    given: dict[str, Any] = dict(locals())
    if isinstance(answers, (list, tuple)):
        given["answers"] = _program.Repeated(answers)
    if deviations is not None:
        given["deviations"] = _program.Words(deviations)
    return _program.run("study score", given, "study")
