"""Times and memory of the Python package beside smplx and PyTorch, in one run.

    python benches/python.py

Two threads each; the median of the repetitions, milliseconds.
"""

import os

os.environ.setdefault("RAYON_NUM_THREADS", "2")

import pickle
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import smplx
import torch

import cape
import cape.torch

torch.set_num_threads(2)


def median(call, seconds=3.0):
    call()
    times = []
    end = time.perf_counter() + seconds
    while len(times) < 5 or time.perf_counter() < end:
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def peer(body, n):
    with tempfile.TemporaryDirectory() as place:
        body.model.save(Path(place) / "SMPL_NEUTRAL.npz")
        with np.load(Path(place) / "SMPL_NEUTRAL.npz") as arrays:
            (Path(place) / "SMPL_NEUTRAL.pkl").write_bytes(pickle.dumps(dict(arrays)))
        return smplx.SMPL(str(Path(place) / "SMPL_NEUTRAL.pkl"), batch_size=n)


def bodies():
    body = cape.create()
    layer = cape.torch.SMPL(body)
    print("| SMPL | batch | cape, ms | smplx, ms | ratio |\n|---|---|---|---|---|")
    for n in (1, 16, 256):
        other = peer(body, n)
        rng = np.random.default_rng(n)
        shapes = {"betas": (1, 10), "body_pose": (0.3, 69), "global_orient": (1, 3), "transl": (1, 3)}
        arrays = {
            name: rng.normal(scale=scale, size=(n, width)).astype(np.float32)
            for name, (scale, width) in shapes.items()
        }
        tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
        with torch.no_grad():
            theirs = median(lambda: other(**tensors))
        ours = median(lambda: body(**arrays))
        print(f"| forward | {n} | {ours:.2f} | {theirs:.2f} | {ours / theirs:.2f} |")
        tracked = {name: tensor.clone().requires_grad_() for name, tensor in tensors.items()}
        weights = torch.randn(n, 6890, 3)

        def both(model, tracked=tracked, weights=weights):
            for tensor in tracked.values():
                tensor.grad = None
            (model(**tracked).vertices * weights).sum().backward()

        theirs, ours = median(lambda: both(other)), median(lambda: both(layer))
        print(f"| forward and backward | {n} | {ours:.2f} | {theirs:.2f} | {ours / theirs:.2f} |")


def overhead():
    body = cape.create(num_betas=10)
    arrays = [np.zeros((1, width), dtype=np.float32) for width in (10, 72, 3)]
    inner = median(lambda: body.model.forward(*arrays), 1)
    whole = median(lambda: body(betas=arrays[0]), 1)
    wrong = arrays[0][:, :9].astype(np.int64)

    def refused():
        try:
            body.model.forward(wrong, arrays[1], arrays[2])
        except cape.CapeError:
            pass

    print(f"\ncall of the extension module: {1e3 * median(refused, 1):.1f} µs")
    print(f"arguments in Python: {1e3 * (whole - inner):.1f} µs")


def clothing():
    model = cape.Model.pretrained()
    dress = cape.torch.Dress(model, "longlong")
    print("\n| clothing | batch | ms |\n|---|---|---|")
    for n in (1, 16, 256):
        codes = model.codes("longlong", n=n)
        print(f"| decode | {n} | {median(lambda: model.decode(codes, 'longlong')):.2f} |")
        if n > 16:
            continue
        tracked = torch.from_numpy(codes).requires_grad_()
        print(f"| dress, with gradients | {n} | {median(lambda: dress(tracked).vertices.sum().backward()):.2f} |")


if __name__ == "__main__":
    bodies()
    overhead()
    clothing()
