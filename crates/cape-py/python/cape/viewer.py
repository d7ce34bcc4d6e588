"""The viewer of the program, as part of a notebook or as a folder."""

from __future__ import annotations

import html
import os

from . import _program
from ._options import Gender, Up
from ._program import PathLike


class Viewer(_program.Server):
    """Server of the viewer of a run, a clothing layer, a mesh, a body or a directory of meshes; a notebook shows
    its page.

    Without ``path`` it shows the built-in model. ``body``, or with ``gender`` the directory of one, wears a layer. ``motion``, of which ``up`` is the axis and ``person`` one of
    several, is a file of a motion to offer beside the synthetic ones; ``fps`` is the rate of meshes, per second;
    ``port`` 0 is a free one; other machines can look only with a ``host`` other than this one and
    ``allow_remote``. With ``proxy`` the page is shown through jupyter-server-proxy below that path of the notebook
    server, such as ``/`` or ``/user/me/``; within JupyterHub that is the default. It ends by ``close()``, at the end of a ``with`` block, or with Python.
    """

    def __init__(
        self,
        path: PathLike | None = None,
        *,
        body: PathLike | None = None,
        gender: Gender | None = None,
        motion: PathLike | None = None,
        up: Up = "auto",
        person: str | None = None,
        fps: float | None = None,
        port: int = 0,
        host: str | None = None,
        allow_remote: bool = False,
        proxy: str | None = None,
        threads: int | None = None,
    ) -> None:
        given = {
            "path": path,
            "body": body,
            "gender": gender,
            "motion": motion,
            "up": up,
            "person": person,
            "fps": fps,
            "port": port,
            "host": host,
            "allow_remote": allow_remote,
            "threads": threads,
            "no_open": True,
            "framed": True,
        }
        if proxy is None:
            proxy = os.environ.get("JUPYTERHUB_SERVICE_PREFIX")
        super().__init__("view", {**given, "proxied": proxy is not None}, "path")
        #: Address of the page, on this machine.
        self.url: str = self._result["url"]
        #: Path of the page on the notebook server; None if that is not asked for it.
        self.path: str | None = None
        if proxy is not None:
            self.path = f"{proxy.rstrip('/')}/proxy/{self.url.rsplit(':', 1)[1]}"
        #: Height of the page in a notebook, pixels.
        self.height: int = 620

    def __repr__(self) -> str:
        return f"<cape.Viewer: {self.url}>"

    def _repr_html_(self) -> str:
        if not self._finish.alive:
            return "<p>The viewer is closed.</p>"
        url = html.escape(self.path or self.url, quote=True)
        style = f"width: 100%; height: {self.height}px; border: 0"
        return (
            f'<iframe src="{url}" style="{style}" allow="fullscreen"></iframe>'
            f'<p><a href="{url}" target="_blank">{url}</a></p>'
        )
