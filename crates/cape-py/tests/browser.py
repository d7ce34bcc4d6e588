"""Pages in headless Chromium."""

import base64
import json
import os
import shutil
import struct
import subprocess
import time
import urllib.request
import zlib
from pathlib import Path

import numpy as np
import pytest

NAMES = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"]


def command_line(place, width, height):
    """Chromium with a profile in ``place``."""
    browser = os.environ.get("CAPE_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)
    if browser is None:
        pytest.skip("no Chromium")
    return [
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
    ]


def kept(png, place):
    """Pixels [height, width, 3] of a picture; its PNG is also kept in $CAPE_SHOTS, if that is set."""
    if "CAPE_SHOTS" in os.environ:
        (Path(os.environ["CAPE_SHOTS"]) / f"{Path(place).name}.png").write_bytes(png)
    return pixels(png)


def screenshot(address, place, width=900, height=700, seconds=15):
    """Pixels [height, width, 3] of a page."""
    path = Path(place) / "shot.png"
    options = [f"--timeout={1000 * seconds}", f"--screenshot={path}", address]
    line = [*command_line(place, width, height), *options]
    subprocess.run(line, capture_output=True, timeout=180, check=True)
    return kept(path.read_bytes(), place)


class Tab:
    """A page that is waited for; needs websocket-client, which Jupyter's server brings along."""

    def __init__(self, place, width=1100, height=1000):
        websocket = pytest.importorskip("websocket")
        self._place, self._calls = place, 0
        options = ["--remote-debugging-port=0", "--remote-allow-origins=*", "about:blank"]
        line = [*command_line(place, width, height), *options]
        self._process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = until(lambda: (Path(place) / "profile" / "DevToolsActivePort").read_text().split()[0])
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=30) as answer:
            (page,) = (target for target in json.load(answer) if target["type"] == "page")
        self._socket = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=60)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._socket.close()
        self._process.terminate()
        self._process.wait()

    def _call(self, method, **parameters):
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv())
            if answer.get("id") == self._calls:
                return answer["result"]

    def go(self, address):
        self._call("Page.navigate", url=address)

    def value(self, expression):
        """Value of an expression of JavaScript, None while it cannot be had."""
        return self._call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def picture(self, selector, number=0):
        """Pixels [height, width, 3] of an element, scrolled to."""
        element = f"document.querySelectorAll({json.dumps(selector)})[{number}]"
        self.value(f"{element}.scrollIntoView({{block: 'center'}})")
        time.sleep(0.2)
        box = self.value(f"(({{x, y, width, height}}) => ({{x, y, width, height}}))({element}.getBoundingClientRect())")
        shot = self._call("Page.captureScreenshot", clip={**box, "scale": 1})
        return kept(base64.b64decode(shot["data"]), self._place)


def until(found, seconds=60):
    """What a function returns that is neither false nor an error of a file or a connection."""
    end = time.monotonic() + seconds
    while True:
        try:
            if value := found():
                return value
        except (OSError, IndexError):
            pass
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.1)


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
