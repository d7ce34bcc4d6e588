"""Commands of the program as functions: ``cape.data.inspect("raw")`` is ``cape data inspect raw``."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from ._cape import CapeError

_POLL = 0.2


class Command:
    """A command of the program, or a group of them.

    ``Command("fit").image("keypoints.json", mask="mask.png", out="fit")`` is ``cape fit image
    keypoints.json --mask mask.png --out fit``. Sequences are lists with commas, ``True`` is an option
    without a value, ``False`` and ``None`` leave it out, and ``_`` in a name is ``-``.
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
        self, *arguments: Any, callback: Callable[[dict[str, Any]], object] | None = None, **options: Any
    ) -> Any:
        """Run the command in a process of its own and return its result, that of ``--json``.

        ``callback`` gets each line of ``metrics.jsonl`` in the directory ``out`` when it is written,
        of ``cape train``. An interrupt is passed on: what can be resumed is saved.
        """
        line = [*self._words, *map(_text, arguments), *_options(options), "--json", "--quiet"]
        metrics = None
        if callback is not None:
            if "out" not in options:
                raise CapeError("callback: expected a command with `out`")
            metrics = _Lines(Path(options["out"]) / "metrics.jsonl", callback)
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
            with _start(line, out, errors) as process:
                try:
                    _wait(process, metrics)
                except BaseException:
                    process.send_signal(signal.SIGINT)
                    process.wait()
                    raise
            result, message = (_content(stream) for stream in (out, errors))
        if process.returncode != 0:
            raise CapeError(message.strip() or f"exit code {process.returncode}")
        return json.loads(result) if result.strip() else None


class Viewer:
    """Server of the viewer of a run, a mesh or a body; a notebook shows a link to its page."""

    def __init__(self, path: str | os.PathLike[str] | None = None, **options: Any) -> None:
        given = [] if path is None else [os.fspath(path)]
        line = ["view", *given, *_options({"no_open": True, **options}), "--json"]
        self._process = _start(line, subprocess.PIPE, subprocess.PIPE)
        assert self._process.stdout is not None
        text = b""
        for part in self._process.stdout:
            text += part
            if part.rstrip() == b"}":
                break
        if not text:
            _, errors = self._process.communicate()
            raise CapeError(errors.decode(errors="replace").strip())
        #: Address of the page, on this machine.
        self.url: str = json.loads(text)["url"]

    def close(self) -> None:
        """End the server."""
        self._process.terminate()
        self._process.communicate()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<a href="{self.url}" target="_blank">{self.url}</a>'


class _Lines:
    """Objects of a file of JSON lines, passed on as they are appended."""

    def __init__(self, path: Path, each: Callable[[dict[str, Any]], object]) -> None:
        self._path, self._each = path, each
        self._at = path.stat().st_size if path.exists() else 0

    def pass_on(self) -> None:
        if not self._path.exists():
            return
        with self._path.open("rb") as file:
            file.seek(self._at)
            for line in file:
                if not line.endswith(b"\n"):
                    break
                self._at += len(line)
                self._each(json.loads(line))


def _start(line: list[str], out: IO[bytes] | int, errors: IO[bytes] | int) -> subprocess.Popen[bytes]:
    # A session of its own: the terminal's Ctrl-C reaches the command once, from here.
    return subprocess.Popen(
        [sys.executable, "-m", "cape", *line], stdout=out, stderr=errors, start_new_session=True
    )


def _wait(process: subprocess.Popen[bytes], metrics: _Lines | None) -> None:
    while True:
        try:
            process.wait(_POLL if metrics else None)
            break
        except subprocess.TimeoutExpired:
            if metrics:
                metrics.pass_on()
    if metrics:
        metrics.pass_on()


def _content(stream: IO[bytes]) -> str:
    stream.seek(0)
    return stream.read().decode(errors="replace")


def _options(options: dict[str, Any]) -> list[str]:
    line = []
    for name, value in options.items():
        option = "-" + name if len(name) == 1 else "--" + name.replace("_", "-")
        if value is True:
            line.append(option)
        elif value is not False and value is not None:
            # One word, so that a negative number is not taken for an option.
            line.append(f"{option}={_text(value)}")
    return line


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return ",".join(map(_text, value))
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)
