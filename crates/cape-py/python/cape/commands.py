"""Commands of the program as functions: ``cape.eval.run("run")`` is ``cape eval run run``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import _program
from ._cape import CapeError


class Command:
    """A command of the program, or a group of them.

    ``Command("model").pack("run", out="model.safetensors")`` is ``cape model pack run --out
    model.safetensors``. Sequences are lists with commas, ``True`` is an option without a value, ``False``
    and ``None`` leave it out, and ``_`` in a name is ``-``.
    """

    def __init__(self, *words: str) -> None:
        self._words = words

    def __getattr__(self, name: str) -> Command:
        if name.startswith("_"):
            raise AttributeError(name)
        return Command(*self._words, name.replace("_", "-"))

    def __repr__(self) -> str:
        return f"<{' '.join(['cape', *self._words])}>"

    def __call__(
        self,
        *arguments: Any,
        callback: Callable[[_program.Metrics], object] | None = None,
        **options: Any,
    ) -> Any:
        """Run the command in a process of its own and return its result, that of ``--json``.

        ``callback`` gets each line of ``metrics.jsonl`` in the directory ``out`` when it is written. An
        interrupt is passed on: what can be resumed is saved.
        """
        if callback is not None and "out" not in options:
            raise CapeError("callback: expected a command with `out`")
        given = {"": list(arguments), **options}
        return _program.run(" ".join(self._words), given, "", callback=callback)
