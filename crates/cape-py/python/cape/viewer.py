"""The viewer of the program, as part of a notebook."""

from __future__ import annotations

import html
import json
import os
import subprocess
import weakref
from typing import Any

from . import _program
from ._cape import CapeError


class Viewer:
    """Server of the viewer of a run, a mesh, a body or a directory of meshes; a notebook shows its page.

    Without ``path`` it shows the built-in model. Options are those of ``cape view``, such as
    ``motion="walk.npz"``, ``port=8080`` and ``fps=15``. It ends by ``close()``, at the end of a ``with``
    block, or with Python.
    """

    def __init__(self, path: str | os.PathLike[str] | None = None, **options: Any) -> None:
        given = [] if path is None else [os.fspath(path)]
        line = ["view", *given, *_program.option_words({"no_open": True, "framed": True, **options})]
        process = _program.start([*line, "--json"], subprocess.PIPE, subprocess.PIPE)
        self._finish = weakref.finalize(self, _end, process)
        text = b""
        for part in process.stdout or ():
            text += part
            if part.rstrip() == b"}":
                break
        if not text:
            _, errors = process.communicate()
            raise CapeError(errors.decode(errors="replace").strip())
        #: Address of the page, on this machine.
        self.url: str = json.loads(text)["url"]
        #: Height of the page in a notebook, pixels.
        self.height: int = 620

    def close(self) -> None:
        """End the server."""
        self._finish()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<cape.Viewer: {self.url}>"

    def _repr_html_(self) -> str:
        if not self._finish.alive:
            return "<p>The viewer is closed.</p>"
        url = html.escape(self.url, quote=True)
        style = f"width: 100%; height: {self.height}px; border: 0"
        return (
            f'<iframe src="{url}" style="{style}" allow="fullscreen"></iframe>'
            f'<p><a href="{url}" target="_blank">{url}</a></p>'
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    process.communicate()
