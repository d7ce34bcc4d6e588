"""JupyterLab shows what bodies, meshes and viewers show in a notebook; run if $CAPE_JUPYTERLAB is set."""

import contextlib
import os
import socket
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

import cape
from browser import Tab, until

if "CAPE_JUPYTERLAB" not in os.environ:
    pytest.skip("JupyterLab: $CAPE_JUPYTERLAB is not set", allow_module_level=True)
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("jupyterlab")


@contextlib.contextmanager
def lab(folder):
    """Address of JupyterLab in a folder."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    options = ["--no-browser", "--allow-root", f"--port={port}", "--port-retries=0", "--IdentityProvider.token="]
    line = [sys.executable, "-m", "jupyterlab", *options, f"--ServerApp.root_dir={folder}"]
    with subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            address = f"http://localhost:{port}"
            until(lambda: urllib.request.urlopen(f"{address}/api", timeout=5).close() is None)
            yield address
        finally:
            server.terminate()


def notebook(path, *pages):
    """A notebook whose cells have shown pages."""
    cells = []
    for page in pages:
        output = nbformat.v4.new_output("display_data", data={"text/html": page})
        cells.append(nbformat.v4.new_code_cell(path.stem, outputs=[output], execution_count=1))
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    book = nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})
    nbformat.write(book, path)
    return book


def coloured(picture):
    """Share of a picture that is skin or cloth; the pages are grey."""
    return (np.ptp(picture.astype(int), axis=-1) > 24).mean()


def test_jupyterlab_shows_meshes_and_viewers(tmp_path, monkeypatch):
    for name in ("CONFIG", "DATA", "RUNTIME"):
        monkeypatch.setenv(f"JUPYTER_{name}_DIR", os.fspath(tmp_path / name.lower()))
    books = tmp_path / "books"
    books.mkdir()
    dressed = cape.Model.pretrained().sample("longlong", seed=3)
    frames = ".jp-OutputArea-output iframe"
    with cape.Viewer() as viewer:
        pages = [dressed.mesh()._repr_html_(), viewer._repr_html_()]
        book = notebook(books / "own.ipynb", *pages)
        nbformat.sign.NotebookNotary().sign(book)
        notebook(books / "foreign.ipynb", *pages)
        with lab(books) as address, Tab(tmp_path) as tab:
            tab.go(f"{address}/lab/tree/own.ipynb?reset")
            until(lambda: tab.value(f"document.querySelectorAll('{frames}').length") == 2)
            for number in range(2):
                until(lambda: 0.02 < coloured(tab.picture(frames, number)) < 0.5)
            shown = "getComputedStyle(document.querySelector('.cape-picture')).display"
            assert tab.value(shown) == "none"
            # Of a notebook of somebody else, frames are removed.
            tab.go(f"{address}/lab/tree/foreign.ipynb?reset")
            place = ".jp-OutputArea-output img"
            until(lambda: tab.value(f"document.querySelector('{place}').naturalWidth"))
            assert tab.value(f"document.querySelectorAll('{frames}').length") == 0
            assert 0.05 < coloured(tab.picture(place)) < 0.5
