"""Pages in headless Chromium."""

import os
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

NAMES = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"]


def screenshot(address, place, width=900, height=700, seconds=15):
    """Pixels [height, width, 3] of a page; its PNG is also kept in $CAPE_SHOTS, if that is set."""
    browser = os.environ.get("CAPE_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
    if browser is None:
        pytest.skip("no Chromium")
    path = Path(place) / "shot.png"
    subprocess.run(
        [
            browser,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu-sandbox",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--hide-scrollbars",
            # Frames of other origins would be drawn by other processes, after the picture is taken.
            "--disable-site-isolation-trials",
            "--disable-features=IsolateOrigins,site-per-process",
            f"--user-data-dir={Path(place) / 'profile'}",
            f"--window-size={width},{height}",
            f"--timeout={1000 * seconds}",
            f"--screenshot={path}",
            address,
        ],
        capture_output=True,
        timeout=180,
        check=True,
    )
    if "CAPE_SHOTS" in os.environ:
        shutil.copy(path, Path(os.environ["CAPE_SHOTS"]) / f"{Path(place).name}.png")
    return pixels(path.read_bytes())


def pixels(png):
    """Pixels [height, width, 3] of a PNG of 8 bits without interlacing."""
    at, data = 8, b""
    while at < len(png):
        (length,) = struct.unpack(">I", png[at : at + 4])
        kind, content = png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height, bits, colour, *_, interlaced = struct.unpack(">IIBBBBB", content)
            assert bits == 8 and colour in (2, 6) and not interlaced
            channels = 3 if colour == 2 else 4
        if kind == b"IDAT":
            data += content
        at += length + 12
    data, width = zlib.decompress(data), width * channels
    image, above = np.empty((height, width), np.uint8), bytearray(width)
    for y in range(height):
        start = y * (width + 1)
        above = unfiltered(data[start], bytearray(data[start + 1 : start + 1 + width]), above, channels)
        image[y] = above
    return image.reshape(height, -1, channels)[:, :, :3]


def unfiltered(kind, line, above, step):
    """Bytes of a row from the differences of a filter."""
    if kind == 2:
        return bytearray((a + b) & 255 for a, b in zip(line, above))
    for i in range(len(line) if kind else 0):
        before, corner = (line[i - step], above[i - step]) if i >= step else (0, 0)
        if kind == 1:
            guess = before
        elif kind == 3:
            guess = (before + above[i]) >> 1
        else:
            p = before + above[i] - corner
            a, b, c = abs(p - before), abs(p - above[i]), abs(p - corner)
            guess = before if a <= b and a <= c else above[i] if b <= c else corner
        line[i] = (line[i] + guess) & 255
    return line
