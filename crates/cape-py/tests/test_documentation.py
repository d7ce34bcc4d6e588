"""Examples of the README and of the book run, and the book's pictures are theirs."""

import os
import re
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from browser import pixels

ROOT = Path(__file__).resolve().parents[3]
BOOK = ROOT / "docs" / "book" / "src"
PAGES = [ROOT / "README.md", BOOK / "guide" / "python.md"]
#: Pages whose blocks run one after another, as in a notebook.
NOTEBOOKS = sorted((BOOK / "python").glob("*.md"))


def blocks(page):
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


EXAMPLES = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, code in enumerate(blocks(page))
]


def needs(code):
    for name in ("torch", "scipy", "trimesh", "jax"):
        if re.search(rf"^\s*(import|from) .*\b{name}\b", code, re.M):
            pytest.importorskip(name)


@pytest.mark.parametrize("code", EXAMPLES)
def test_example(code, tmp_path, monkeypatch):
    needs(code)
    if "csr_matrix" in code:
        pytest.importorskip("scipy")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "example", "exec"), {})
    for name in re.findall(r'save\("([^"]+)"', code):
        assert (tmp_path / name).stat().st_size > 1000


@pytest.mark.parametrize("page", NOTEBOOKS, ids=lambda page: page.stem)
def test_notebook(page, tmp_path, monkeypatch):
    """Runs a page, whose pictures must be those of the book; $CAPE_PICTURES names a directory that they
    are written to instead."""
    code = blocks(page)
    needs("\n".join(code))
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "notebook"}
    for number, block in enumerate(code):
        exec(compile(block, f"{page.name}, block {number + 1}", "exec"), names)
        show_last(block, names)
    pictures = re.findall(r"\(\.\./pictures/([^)]+\.png)\)", page.read_text(encoding="utf-8"))
    assert pictures
    for name in pictures:
        if "CAPE_PICTURES" in os.environ:
            shutil.copy(tmp_path / name, os.environ["CAPE_PICTURES"])
            continue
        made, shown = (tmp_path / name).read_bytes(), (BOOK / "pictures" / name).read_bytes()
        assert struct.unpack(">II", made[16:24]) == struct.unpack(">II", shown[16:24])
        difference = np.abs(pixels(made).astype(int) - pixels(shown).astype(int))
        # Rounding differs between processors, and grows where something was trained or fitted.
        assert difference.mean() < 6


def show_last(block, names):
    """What a notebook does with the value of a block's last line."""
    last = block.rstrip().splitlines()[-1]
    if re.fullmatch(r"\w+", last):
        value = names[last]
        assert "<iframe" in value._repr_html_()


def test_examples_are_found():
    assert len(EXAMPLES) >= 7 and len(NOTEBOOKS) == 6
