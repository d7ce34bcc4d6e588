"""Pictures of meshes, and pages that notebooks show."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Optional

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape

#: Colour of meshes without colours: sRGB.
GREY: NDArray[np.float32] = np.array([0.72, 0.74, 0.77], dtype=np.float32)
#: Most bodies of a picture or a page.
MOST = 8
#: Colours of vertices [V, 3], sRGB from 0 to 1, or none.
Colours = Optional[NDArray[np.float32]]

#: Height of a mesh in a notebook, pixels.
_HEIGHT = 420
#: Width and height of a picture of one body, pixels.
_PICTURE = (320, 420)
#: Largest 16-bit number.
_STEPS = 65535


def write_png(path: str | os.PathLike[str], pixels: ArrayLike) -> None:
    """Write pixels [height, width], [height, width, 3] or [height, width, 4] as PNG: numbers from 0 to
    255, or True and False."""
    image = np.asarray(pixels)
    if image.dtype == np.bool_:
        image = np.where(image, np.uint8(255), np.uint8(0))
    if image.dtype != np.uint8:
        raise _cape.CapeError(f"pixels: numbers of type {image.dtype}, expected uint8 or bool")
    if image.ndim == 2:
        image = np.repeat(image[:, :, None], 3, axis=2)
    if image.ndim != 3 or image.shape[2] not in (3, 4):
        raise _cape.CapeError(f"pixels: shape {list(image.shape)}, expected [height, width, 3]")
    if image.shape[2] == 3:
        image = np.concatenate([image, np.full_like(image[:, :, :1], 255)], axis=2)
    Path(path).write_bytes(_cape.encode_png(image))


def draw(
    bodies: Sequence[NDArray[np.float32]],
    faces: NDArray[np.uint32],
    colours: Sequence[Colours],
    size: tuple[int, int],
) -> NDArray[np.uint8]:
    """Draw bodies [V, 3] beside each other, at most eight: pixels [height, n width, 4]."""
    pictures = [
        _cape.draw(body, faces, _painted(body, paint), size)
        for body, paint in zip(bodies[:MOST], colours)
    ]
    return np.hstack(pictures)


def bytes_of(colours: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colours from 0 to 1 as numbers from 0 to 255."""
    return np.rint(255 * colours).astype(np.uint8)


def _painted(body: NDArray[np.float32], colours: Colours) -> NDArray[np.float32]:
    return np.broadcast_to(GREY, body.shape) if colours is None else colours


def page(
    bodies: Sequence[NDArray[np.float32]], faces: NDArray[np.uint32], colours: Sequence[Colours]
) -> str:
    """Frame of a page that shows bodies [V, 3] of the same ``faces`` beside each other, at most eight.

    Where a notebook is not trusted, frames and styles are removed, and a picture shows itself instead.
    """
    bodies = bodies[:MOST]
    ends = [(body.min(axis=0), body.max(axis=0)) for body in bodies]
    gap = 1.25 * max(high[0] - low[0] for low, high in ends)
    placed = list(bodies)
    if len(bodies) > 1:
        # Each is moved sideways only.
        centres = [(low[0] + high[0]) / 2 for low, high in ends]
        shifts = [k * gap - centre for k, centre in enumerate(centres)]
        placed = [body + np.array([x, 0, 0], dtype=np.float32) for body, x in zip(bodies, shifts)]
    low = np.min([body.min(axis=0) for body in placed], axis=0)
    step = (np.max([body.max(axis=0) for body in placed], axis=0) - low) / _STEPS
    wide = len(bodies[0]) > _STEPS + 1
    scene = {
        "low": low.tolist(),
        "step": step.tolist(),
        "wide": wide,
        "vertices": len(bodies[0]),
        "faces": _text(faces.astype("<u4" if wide else "<u2")),
        "bodies": [
            {
                "vertices": _text(np.rint((body - low) / np.where(step > 0, step, 1)).astype("<u2")),
                "colours": _text(bytes_of(_painted(body, paint))),
            }
            for body, paint in zip(placed, colours)
        ],
    }
    content = html.escape(_template().replace("SCENE", json.dumps(scene)), quote=True)
    style = f"width: 100%; height: {_HEIGHT}px; border: 0"
    image = base64.b64encode(_cape.encode_png(draw(bodies, faces, colours, _PICTURE))).decode("ascii")
    return (
        "<style>.cape-page + .cape-picture { display: none }</style>"
        f'<iframe class="cape-page" style="{style}" srcdoc="{content}"></iframe>'
        f'<img class="cape-picture" alt="" src="data:image/png;base64,{image}">'
    )


@lru_cache
def _template() -> str:
    return (files("cape") / "mesh.html").read_text(encoding="utf-8")


def _text(array: NDArray[Any]) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
