"""Times and memory of the Python package beside its peers, in one run, ours and theirs in turn.

    python benches/python.py [--peers DIR] [TABLE …]

Tables are bodies, memory, overhead, clothing, decode, pyramid and pickle; all by default. The peers are
smplx and PyTorch; for `decode` the file `cape_torch.py` in DIR; for `pyramid` fast_simplification, on
which trimesh's decimation rests; for `pickle` chumpy, which is patched to run on a NumPy of today. Two
threads each; medians, milliseconds.
"""

import argparse
import inspect
import os
import pickle
import re
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

os.environ.setdefault("RAYON_NUM_THREADS", "2")

import numpy as np

import cape

#: Time between ours and theirs, seconds: threads of PyTorch wait actively after each call.
PAUSE = 0.03


def in_turn(*calls, seconds=4.0):
    """Median of each call, milliseconds. They are called in turn, several times at once each."""
    times = [[] for _ in calls]
    for call in calls:
        call()
    end = time.perf_counter() + seconds
    while len(times[0]) < 5 or time.perf_counter() < end:
        for call, taken in zip(calls, times):
            time.sleep(PAUSE)
            call()
            block = time.perf_counter() + 0.15
            while True:
                start = time.perf_counter()
                call()
                taken.append(time.perf_counter() - start)
                if time.perf_counter() > block:
                    break
    return [1e3 * statistics.median(taken) for taken in times]


def with_torch():
    import torch

    torch.set_num_threads(2)
    return torch


def peer(body, n):
    import smplx

    with tempfile.TemporaryDirectory() as place:
        body.model.save(Path(place) / "SMPL_NEUTRAL.npz")
        with np.load(Path(place) / "SMPL_NEUTRAL.npz") as arrays:
            (Path(place) / "SMPL_NEUTRAL.pkl").write_bytes(pickle.dumps(dict(arrays)))
        return smplx.SMPL(str(Path(place) / "SMPL_NEUTRAL.pkl"), batch_size=n)


def inputs(n):
    rng = np.random.default_rng(n)
    shapes = {"betas": (1, 10), "body_pose": (0.3, 69), "global_orient": (1, 3), "transl": (1, 3)}
    return {
        name: rng.normal(scale=scale, size=(n, width)).astype(np.float32)
        for name, (scale, width) in shapes.items()
    }


def backward(model, n):
    """A function that runs a body forward and backward."""
    torch = with_torch()
    tracked = {name: torch.from_numpy(array).requires_grad_() for name, array in inputs(n).items()}
    weights = torch.randn(n, 6890, 3)

    def both():
        for tensor in tracked.values():
            tensor.grad = None
        (model(**tracked).vertices * weights).sum().backward()

    return both


def bodies():
    import cape.torch

    torch = with_torch()
    body = cape.create()
    layer = cape.torch.SMPL(body)
    print("| SMPL | batch | cape, ms | smplx, ms | ratio |\n|---|---|---|---|---|")
    for n in (1, 16, 256):
        other, arrays = peer(body, n), inputs(n)
        tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}

        def theirs(other=other, tensors=tensors):
            with torch.no_grad():
                other(**tensors)

        row("forward", n, in_turn(lambda: body(**arrays), theirs))
        row("forward and backward", n, in_turn(backward(layer, n), backward(other, n)))


def row(name, n, times):
    ours, theirs = times
    print(f"| {name} | {n} | {ours:.2f} | {theirs:.2f} | {ours / theirs:.2f} |", flush=True)


def peak(library, n):
    """Growth of the resident memory over that of the loaded body, MB, in a process of its own."""
    line = [sys.executable, __file__, "--peak", library, str(n)]
    out = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    # smplx prints remarks before.
    return float(out.split()[-1])


def measure_peak(library, n):
    import cape.torch

    torch = with_torch()
    body = cape.create()
    call = backward(cape.torch.SMPL(body) if library == "cape" else peer(body, n), n)
    # Our body is prepared when it is posed first.
    body()
    # What PyTorch's first gradients load is not counted.
    square = torch.ones(200, 200, requires_grad=True)
    (square @ square).sum().backward()
    Path("/proc/self/clear_refs").write_text("5")
    before = resident("VmRSS")
    call()
    print((resident("VmHWM") - before) / 1e3)


def resident(name):
    """Kilobytes."""
    return int(re.search(rf"{name}:\s+(\d+)", Path("/proc/self/status").read_text()).group(1))


def memory():
    print("\n| memory of forward and backward | batch | cape, MB | smplx, MB | ratio |\n|---|---|---|---|---|")
    for n in (1, 16, 256):
        pairs = [(peak("cape", n), peak("smplx", n)) for _ in range(3)]
        row("peak over the loaded body", n, [statistics.median(side) for side in zip(*pairs)])


def overhead():
    body = cape.create(num_betas=10)
    arrays = [np.zeros((1, width), dtype=np.float32) for width in (10, 72, 3)]
    wrong = arrays[0][:, :9].astype(np.int64)

    def refused():
        try:
            body.model.forward(wrong, arrays[1], arrays[2])
        except cape.CapeError:
            pass

    inner, whole, call = in_turn(
        lambda: body.model.forward(*arrays), lambda: body(betas=arrays[0]), refused, seconds=3
    )
    print(f"\ncall of the extension module: {1e3 * call:.1f} µs")
    print(f"arguments in Python: {1e3 * (whole - inner):.1f} µs")


def clothing():
    import cape.torch

    torch = with_torch()
    model = cape.Model.pretrained()
    dress = cape.torch.Dress(model, "longlong")
    print("\n| clothing | batch | ms |\n|---|---|---|")
    for n in (1, 16, 256):
        codes = model.codes("longlong", n=n)
        (decode,) = in_turn(lambda: model.decode(codes, "longlong"))
        print(f"| decode | {n} | {decode:.2f} |", flush=True)
        if n <= 16:
            tracked = torch.from_numpy(codes).requires_grad_()
            (time_,) = in_turn(lambda: dress(tracked).vertices.sum().backward())
            print(f"| dress, with gradients | {n} | {time_:.2f} |", flush=True)


def decode(peers):
    """The paper's decoder, by a run of one step, beside an implementation in PyTorch."""
    if peers is None:
        print("\ndecode: left out, --peers is not given")
        return
    with tempfile.TemporaryDirectory() as place:
        place = Path(place)
        cape.data.synth(place / "raw", subjects=1, frames_per_sequence=6, outfits=["longlong"], motions=["walk_march", "soccer"])
        cape.data.pack(place / "raw", place / "packed")
        training = cape.train(data=place / "packed", out=place / "run", preset="paper", epochs=1, batch=2)
        model = training.model()
    print("\n| decode, paper's preset | batch | cape, ms | PyTorch, ms | ratio |\n|---|---|---|---|---|")
    for n in (1, 16):
        codes = model.codes("longlong", n=n)
        rounds = []
        for _ in range(3):
            (ours,) = in_turn(lambda: model.decode(codes, "longlong"), seconds=2)
            rounds.append((ours, peer_decode(peers, n)))
        row("tuned peer", n, [statistics.median(side) for side in zip(*rounds)])


def peer_decode(peers, n):
    line = [sys.executable, "-B", Path(peers) / "cape_torch.py", "decode", "--impl", "smart"]
    line += ["--batch", str(n), "--threads", "2", "--onednn", "--malloc", "--reps", "9", "--timeout", "10"]
    out = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    return 1e3 * float(re.search(r": ([0-9.e+-]+) s ", out.strip().splitlines()[-1]).group(1))


def pyramid():
    import fast_simplification

    body = cape.create()
    points, faces = body.model.v_template, body.faces
    counts = [3445, 1723, 862, 431]

    def theirs():
        at, triangles = points.astype(np.float32), faces.astype(np.int32)
        for count in counts:
            # Closed surfaces have twice as many triangles as vertices.
            at, triangles = fast_simplification.simplify(at, triangles, target_count=2 * count)
        return at

    def ours():
        return cape.MeshPyramid(points, faces, [2, 2, 2, 2])

    print(f"\n{len(theirs())} vertices by theirs, {len(ours().level(4)[0])} by ours")
    print("| pyramid | levels | cape, ms | fast_simplification, ms | ratio |\n|---|---|---|---|---|")
    row("meshes, ours with matrices", 4, in_turn(ours, theirs))


def chumpy_of_today():
    """chumpy needs names that NumPy and Python have given up."""
    warnings.simplefilter("ignore")
    import scipy.sparse  # noqa: F401

    for name, kind in {"int": int, "float": float, "complex": complex, "object": object, "str": str}.items():
        setattr(np, name, kind)
    np.unicode, np.nan, np.inf = str, float("nan"), float("inf")
    inspect.getargspec = inspect.getfullargspec
    import chumpy

    return chumpy


def pickles():
    chumpy = chumpy_of_today()
    import scipy.sparse

    body = cape.create()
    with tempfile.TemporaryDirectory() as place:
        body.model.save(Path(place) / "body.npz")
        with np.load(Path(place) / "body.npz") as file:
            arrays = dict(file)
        # As in the official files: the shape directions are chumpy's, the regressor is sparse.
        arrays["shapedirs"] = chumpy.array(arrays["shapedirs"])
        arrays["J_regressor"] = scipy.sparse.csc_matrix(arrays["J_regressor"])
        path = Path(place) / "body.pkl"
        path.write_bytes(pickle.dumps(arrays, protocol=2))

        def theirs():
            with open(path, "rb") as file:
                loaded = pickle.load(file, encoding="latin1")
            return np.array(loaded["shapedirs"]), loaded["J_regressor"].toarray()

        def ours():
            return cape.load_smpl(path).shapedirs

        np.testing.assert_array_equal(theirs()[0], ours())
        size = path.stat().st_size / 1e6
        print(f"\n| pickle of {size:.0f} MB | | cape, ms | chumpy, ms | ratio |\n|---|---|---|---|---|")
        row("load", 1, in_turn(ours, theirs))


TABLES = {
    "bodies": bodies,
    "memory": memory,
    "overhead": overhead,
    "clothing": clothing,
    "decode": decode,
    "pyramid": pyramid,
    "pickle": pickles,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", type=Path)
    parser.add_argument("--peak", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("tables", nargs="*", metavar="TABLE", choices=[*TABLES, []])
    given = parser.parse_args()
    if given.peak:
        measure_peak(given.peak[0], int(given.peak[1]))
    else:
        for name in given.tables or TABLES:
            TABLES[name](given.peers) if name == "decode" else TABLES[name]()
