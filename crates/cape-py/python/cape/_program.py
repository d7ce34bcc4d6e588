"""The program as a process: its command lines, results, metrics and interrupts."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Union

from ._cape import CapeError

if TYPE_CHECKING:
    from typing_extensions import Self

#: Path of a file or directory.
PathLike = Union[str, "os.PathLike[str]"]
#: Result of a command, that of ``--json``.
Report = dict[str, Any]
#: Line of ``metrics.jsonl``.
Metrics = dict[str, Any]

_POLL = 0.2
#: Exit code of a command that was interrupted and can be resumed.
_INTERRUPTED = 130
_WINDOWS = os.name == "nt"


def run(
    command: str,
    given: Mapping[str, Any],
    *positional: str,
    callback: Callable[[Metrics], object] | None = None,
    accepted: int = _INTERRUPTED,
) -> Any:
    """Run a command in a process of its own with the arguments of a function, and return its result.

    ``positional`` names the arguments that are no options. ``callback`` gets each line of
    ``metrics.jsonl`` in the directory ``out`` when it is written. What it raises, and an interrupt, end
    the command as Ctrl-C does: what can be resumed is saved before they go on. ``accepted`` is an exit
    code, beside 0, of a command that has a result.
    """
    line = _line(command, given, positional)
    metrics = None
    if callback is not None:
        metrics = _Lines(Path(given["out"]) / "metrics.jsonl", callback)
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as errors:
        with start(line, out, errors) as process:
            try:
                _wait(process, metrics)
            except BaseException:
                _end(process)
                raise
        result, message = (_content(stream) for stream in (out, errors))
    if process.returncode != 0 and not (process.returncode == accepted and result.strip()):
        raise CapeError(message.strip() or f"exit code {process.returncode}")
    return json.loads(result) if result.strip() else None


class Server:
    """A command that serves until it is ended: by ``close()``, at the end of a ``with`` block, or with
    Python."""

    def __init__(self, command: str, given: Mapping[str, Any], *positional: str) -> None:
        with tempfile.TemporaryFile() as errors:
            process = start(_line(command, given, positional), subprocess.PIPE, errors)
            try:
                printed = _first_result(process)
            except BaseException:
                _terminate(process)
                raise
            if not printed:
                process.communicate()
                raise CapeError(_content(errors).strip() or f"exit code {process.returncode}")
        self._finish = weakref.finalize(self, _terminate, process)
        self._result: Any = json.loads(printed)

    def close(self) -> None:
        """End the server."""
        self._finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def start(
    line: list[str], out: IO[bytes] | int, errors: IO[bytes] | int
) -> subprocess.Popen[bytes]:
    """Start the program; the terminal's Ctrl-C does not reach it."""
    arguments = [sys.executable, "-m", "cape", *line]
    if _WINDOWS:
        group = subprocess.CREATE_NEW_PROCESS_GROUP  # type: ignore[attr-defined]
        return subprocess.Popen(arguments, stdout=out, stderr=errors, creationflags=group)
    return subprocess.Popen(arguments, stdout=out, stderr=errors, start_new_session=True)


class Repeated(list[Any]):
    """Values that each have the name of the option before them."""


class Words(list[Any]):
    """Values that are words of their own behind the name of the option; none of them is negative."""


def option_words(options: Mapping[str, Any]) -> list[str]:
    """Options of a command line. ``True`` is an option without a value; ``False`` and ``None`` leave it
    out."""
    line = []
    for name, value in options.items():
        option = "-" + name if len(name) == 1 else "--" + name.strip("_").replace("_", "-")
        if value is True:
            line.append(option)
        elif isinstance(value, Words):
            line += [option, *map(text, value)]
        elif value is not False and value is not None:
            # One word, so that a negative number is not taken for an option.
            values = value if isinstance(value, Repeated) else [value]
            line += [f"{option}={text(each)}" for each in values]
    return line


def _line(command: str, given: Mapping[str, Any], positional: tuple[str, ...]) -> list[str]:
    """A command with the arguments of a function, whose result is printed as JSON."""
    values = [given[name] for name in positional if given[name] is not None]
    words = [word for value in values for word in (value if isinstance(value, list) else [value])]
    options = {name: value for name, value in given.items() if name not in positional}
    return [*command.split(), *map(text, words), *option_words(options), "--json", "--quiet"]


def text(value: Any) -> str:
    """A value as the program reads it: sequences with commas, mappings as ``name=value``."""
    if isinstance(value, Mapping):
        return ",".join(f"{name}={text(number)}" for name, number in value.items())
    if isinstance(value, (list, tuple)):
        return ",".join(map(text, value))
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        # Arrays and numbers of NumPy, tensors and their elements.
        return text(value.tolist())
    return str(value)


class _Lines:
    """Objects of a file of JSON lines, passed on as they are appended."""

    def __init__(self, path: Path, each: Callable[[Metrics], object]) -> None:
        self._path, self._each = path, each
        self._at = path.stat().st_size if path.exists() else 0

    def pass_on(self) -> None:
        if not self._path.exists():
            return
        # A training that goes on from a checkpoint first removes what came after it.
        self._at = min(self._at, self._path.stat().st_size)
        with self._path.open("rb") as file:
            file.seek(self._at)
            for line in file:
                if not line.endswith(b"\n"):
                    break
                self._at += len(line)
                self._each(json.loads(line))


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


def _end(process: subprocess.Popen[bytes]) -> None:
    """Interrupt a command and wait until it has saved; a second interrupt ends it at once."""
    if process.poll() is None:
        process.send_signal(signal.CTRL_BREAK_EVENT if _WINDOWS else signal.SIGINT)  # type: ignore[attr-defined]
    try:
        process.wait()
    except BaseException:
        process.kill()
        raise


def _first_result(process: subprocess.Popen[bytes]) -> bytes:
    """What a command prints first, an object or a list in JSON."""
    printed = b""
    for part in process.stdout or ():
        printed += part
        # The lines within are indented.
        if part.rstrip() in (b"}", b"]"):
            break
    return printed


def _terminate(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.communicate()


def _content(stream: IO[bytes]) -> str:
    stream.seek(0)
    return stream.read().decode(errors="replace")
