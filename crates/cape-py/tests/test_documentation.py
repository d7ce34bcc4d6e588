"""Examples of the README and of the book run."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES = [ROOT / "README.md", ROOT / "docs" / "book" / "src" / "guide" / "python.md"]
EXAMPLES = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, code in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S))
]


@pytest.mark.parametrize("code", EXAMPLES)
def test_example(code, tmp_path, monkeypatch):
    for name in ("torch", "scipy"):
        if name in code.lower():
            pytest.importorskip(name)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "example", "exec"), {})
    for name in re.findall(r'save\("([^"]+)"', code):
        assert (tmp_path / name).stat().st_size > 1000


def test_examples_are_found():
    assert len(EXAMPLES) >= 7
