#!/usr/bin/env python3
"""Checks the links of the documentation without a network.

    python3 docs/book/check-links.py

Every relative link and image of README.md, ARCHITECTURE.md, CONTRIBUTING.md, data/README.md and of
all Markdown files below docs/ must lead to an existing file, and every anchor to a heading of it.
Links to this repository on GitHub are checked against the working tree. Of the book it also checks that
SUMMARY.md lists every page, that pages link to nothing outside of src/, and that every picture is shown.
Exits with 1 and one line for each fault.
"""
import pathlib
import re
import sys
import urllib.parse

ROOT = pathlib.Path(__file__).resolve().parents[2]
SOURCE = ROOT / "docs" / "book" / "src"
PICTURES = SOURCE / "pictures"
HOME = "https://github.com/cape-rs/cape-rs"

FENCE = re.compile(r"^ {0,3}(```+|~~~+)")
CODE = re.compile(r"(`+)(?!`).*?(?<!`)\1(?!`)")
INCLUDE = re.compile(r"\{\{#include\s+([^}:\s]+)[^}]*\}\}")
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)")
DEFINITION = re.compile(r"^ {0,3}\[[^\]]+\]:\s+<?(\S+?)>?\s*$")
HEADING = re.compile(r"^ {0,3}#{1,6}\s+(.*?)\s*#*\s*$")


def text_lines(path):
    """Number and text of every line outside of fenced code."""
    fence = None
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        mark = FENCE.match(line)
        if mark and fence is None:
            fence = mark.group(1)[0] * 3
        elif mark and line.strip().startswith(fence):
            fence = None
        elif fence is None:
            yield number, line


def slug(heading):
    """The anchor of a heading, as GitHub and mdBook make it."""
    plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    plain = re.sub(r"[*`]", "", plain).strip().lower()
    kept = "".join(c for c in plain if c.isalnum() or c in "-_ ")
    return kept.replace(" ", "-")


def anchors(path, seen=()):
    """All anchors of a page, those of included files among them."""
    found, counts = set(), {}
    for _, line in text_lines(path):
        for included in INCLUDE.findall(line):
            target = (path.parent / included).resolve()
            if target.is_file() and target not in seen:
                found |= anchors(target, (*seen, target))
        heading = HEADING.match(line)
        if heading:
            name = slug(heading.group(1))
            count = counts.get(name, 0)
            counts[name] = count + 1
            found.add(f"{name}-{count}" if count else name)
        found.update(re.findall(r"<a\s+(?:id|name)=\"([^\"]+)\"", line))
    return found


def main():
    pages = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "data/README.md")]
    pages = [page for page in pages if page.exists()] + sorted((ROOT / "docs").rglob("*.md"))
    faults, shown, links = [], set(), 0
    for page in pages:
        in_book = SOURCE in page.parents
        for number, line in text_lines(page):
            where = f"{page.relative_to(ROOT)}:{number}"
            for included in INCLUDE.findall(line):
                if not (page.parent / included).is_file():
                    faults.append(f"{where}: includes {included}, which does not exist")
            line = CODE.sub("", line)
            definition = DEFINITION.match(line)
            targets = LINK.findall(line) + ([definition.group(1)] if definition else [])
            for target in targets:
                links += 1
                at_home = re.match(re.escape(HOME) + r"/(?:blob|tree|edit)/main/([^?#]+)(?:#(.*))?$", target)
                if at_home:
                    file, anchor = ROOT / urllib.parse.unquote(at_home.group(1)), at_home.group(2)
                elif re.match(r"[a-z][a-z0-9+.-]*:", target, re.I):
                    continue
                else:
                    name, _, anchor = target.partition("#")
                    file = (page.parent / urllib.parse.unquote(name)).resolve() if name else page
                    if in_book and SOURCE not in file.parents:
                        faults.append(f"{where}: {target} leads out of the book: use {HOME}/blob/main/…")
                if not file.exists():
                    faults.append(f"{where}: {target} does not exist")
                elif anchor and file.suffix == ".md" and anchor not in anchors(file):
                    faults.append(f"{where}: {target}: no such heading")
                if PICTURES in file.parents:
                    shown.add(file)

    summary = SOURCE / "SUMMARY.md"
    listed = {
        (SOURCE / target.partition("#")[0]).resolve()
        for _, line in text_lines(summary)
        for target in LINK.findall(line)
    }
    for page in sorted(SOURCE.rglob("*.md")):
        if page != summary and page not in listed:
            faults.append(f"{page.relative_to(ROOT)}: not listed in SUMMARY.md")
    for picture in sorted(PICTURES.iterdir()):
        if picture not in shown:
            faults.append(f"{picture.relative_to(ROOT)}: shown nowhere")

    print("\n".join(faults) if faults else f"{links} links in {len(pages)} files: no faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
