"""Training of clothing models."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Optional, TypedDict

from . import _program
from ._cape import CapeError
from ._options import Gender, Preset
from ._program import Metrics, PathLike, Report
from .model import Model

if TYPE_CHECKING:
    from typing_extensions import Unpack

#: A TOML file, or a mapping of its tables.
Config = Optional["PathLike | Mapping[str, Any]"]


@dataclass(frozen=True)
class Training:
    """Result of a training."""

    #: Directory of the run.
    out: Path
    #: True if all epochs are done; otherwise ``resume=True`` goes on.
    finished: bool
    #: Number of complete epochs.
    epochs: int
    #: Number of steps.
    steps: int
    #: Lowest mean validation error, millimetres.
    best_validation: Optional[float]
    #: Training time over all sessions, seconds.
    seconds: float

    def model(self) -> Model:
        """Open the trained model."""
        return Model.load(self.out)


def train(
    config: Config = None,
    callback: Callable[[Metrics], object] | None = None,
    *,
    out: PathLike,
    data: PathLike | None = None,
    resume: bool = False,
    preset: Preset | None = None,
    body: PathLike | None = None,
    gender: Gender | None = None,
    clothing: PathLike | None = None,
    checkpoint_minutes: float | None = None,
    epochs: int | None = None,
    batch: int | None = None,
    peak_rate: float | None = None,
    warmup_epochs: float | None = None,
    schedule: Literal["exponential", "cosine"] | None = None,
    optimiser: Literal["sgd", "adam"] | None = None,
    kl: float | None = None,
    kl_warmup_epochs: float | None = None,
    gan: float | None = None,
    discriminator_rate: float | None = None,
    adversary: Literal["bce", "hinge"] | None = None,
    spectral_norm: bool = False,
    unit: Literal["deviations", "metres"] | None = None,
    bare_weight: float | None = None,
    clothing_patches: bool = False,
    transfer: float | None = None,
    pose_swap: float | None = None,
    precision: Literal["f32", "bf16"] | None = None,
    ema: float | None = None,
    checkpoint_steps: int | None = None,
    log_steps: int | None = None,
    keep: int | None = None,
    preload: bool = False,
    weighting: Literal["barycentric", "release"] | None = None,
    seed: int | None = None,
    threads: int | None = None,
) -> Training:
    """Train a model on a packed set, in a process of its own.

    ``callback`` is called with each line of ``metrics.jsonl`` as it is written: ``step``, ``epoch`` and
    losses every ``log_steps`` steps, and validation errors in millimetres at the end of each epoch. An
    exception that it raises, such as ``KeyboardInterrupt``, and Ctrl-C finish the step, save a checkpoint
    and then go on; ``train(out=…, resume=True)`` continues from it.

    ``config`` is a TOML file or a mapping of its tables, ``{"train": {"epochs": 20}}``; the other
    arguments override it.

    - ``out``: directory of the run, empty or missing, or the one to resume
    - ``data``: packed set; with ``resume`` the run's
    - ``preset``: architecture, instead of ``config``; ``narrow`` has a quarter of the paper's filters
    - ``body``, ``gender``, ``clothing``: body and clothing vertices, if the set has none
    - ``checkpoint_minutes``: between checkpoints within an epoch, 15; 0 saves at the ends of epochs only;
      ``checkpoint_steps`` counts steps
    - ``epochs``, ``batch`` (frames), ``peak_rate``, ``warmup_epochs``, ``schedule``, ``optimiser``
    - ``kl``, ``gan``: weights of losses; ``kl_warmup_epochs``; ``discriminator_rate``, relative to the
      generator's; ``adversary``; ``spectral_norm`` of the discriminator
    - ``unit``: of displacements in the losses; ``bare_weight``: of vertices without clothing;
      ``clothing_patches``: only those count in adversarial losses
    - ``transfer``: share of the frames, 0 to 1, with the code of another frame of the same capture
    - ``pose_swap``: share of the frames, 0 to 1, reconstructed under the pose of another training frame
    - ``precision``: of the products of convolutions, ``bf16`` on processors with AMX or AVX-512 BF16
    - ``ema``: decay of a moving average of the weights, such as 0.999
    - ``log_steps``: between lines of ``metrics.jsonl``; ``keep``: newest checkpoints that are kept;
      ``preload``: the whole set into memory
    - ``weighting``: of up-sampling; ``seed``; ``threads``
    """
    given = dict(locals())
    del given["callback"]
    with _file(config) as given["config"]:
        report = _program.run("train", given, callback=callback)
    return Training(**{**report, "out": Path(report["out"])})


class Settings(TypedDict, total=False):
    """Settings of a training; they are described at :func:`train`."""

    preset: Preset | None
    body: PathLike | None
    gender: Gender | None
    clothing: PathLike | None
    epochs: int | None
    batch: int | None
    peak_rate: float | None
    warmup_epochs: float | None
    schedule: Literal["exponential", "cosine"] | None
    optimiser: Literal["sgd", "adam"] | None
    kl: float | None
    kl_warmup_epochs: float | None
    gan: float | None
    discriminator_rate: float | None
    adversary: Literal["bce", "hinge"] | None
    spectral_norm: bool
    unit: Literal["deviations", "metres"] | None
    bare_weight: float | None
    clothing_patches: bool
    transfer: float | None
    pose_swap: float | None
    precision: Literal["f32", "bf16"] | None
    ema: float | None
    preload: bool
    weighting: Literal["barycentric", "release"] | None
    seed: int | None
    threads: int | None


def check(
    config: Config = None, *, data: PathLike, trial_steps: int = 200, **settings: Unpack[Settings]
) -> Report:
    """Check a configuration by short trainings of ``trial_steps`` each: ``passed``, and the ``findings``."""
    given = {"data": data, "trial_steps": trial_steps, "check": True, **settings}
    with _file(config) as path:
        return _program.run("train", {**given, "config": path}, accepted=1)


def find_rate(
    config: Config = None,
    *,
    data: PathLike,
    out: PathLike | None = None,
    trial_steps: int = 120,
    **settings: Unpack[Settings],
) -> Report:
    """Suggest a learning rate by a range test: ``suggested``, and the losses at all rates.

    ``out`` is a directory for the curves.
    """
    given = {"data": data, "out": out, "trial_steps": trial_steps, "find_rate": True, **settings}
    with _file(config) as path:
        return _program.run("train", {**given, "config": path})


@contextmanager
def _file(config: Config) -> Iterator[PathLike | None]:
    """File of a configuration."""
    if config is None or isinstance(config, (str, os.PathLike)):
        yield config
        return
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "config.toml"
        path.write_text(toml(config), encoding="utf-8")
        yield path


def toml(tables: Mapping[str, Any]) -> str:
    """A mapping of numbers, texts, lists and mappings as TOML."""
    lines: list[str] = []
    _write("", tables, lines)
    return "".join(line + "\n" for line in lines)


def _write(name: str, table: Mapping[str, Any], lines: list[str]) -> None:
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    for key, value in table.items():
        if key in inner or value is None:
            continue
        try:
            # JSON's numbers, texts and lists are TOML's.
            lines.append(f"{json.dumps(str(key))} = {json.dumps(value)}")
        except TypeError as error:
            raise CapeError(f"config: `{key}`: {error}") from error
    for key, value in inner.items():
        path = f"{name}.{json.dumps(str(key))}".lstrip(".")
        lines.append(f"[{path}]")
        _write(path, value, lines)
