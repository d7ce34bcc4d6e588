"""Arguments of all kinds give results or exceptions of Python, never a panic.

``CAPE_FUZZ_CASES=N`` makes N calls.
"""

import os
import random

import numpy as np
import pytest

import cape
from cape import _cape, fit, pictures
from cape.training import toml

EXPECTED = (cape.CapeError, OSError, TypeError, ValueError, OverflowError, MemoryError, IndexError)
CALLS = int(os.environ.get("CAPE_FUZZ_CASES", 2500))


@pytest.fixture(scope="module")
def model():
    return cape.Model.pretrained()


def arrays(choose):
    """An array of random type, shape, order and content."""
    dtype = choose.choice([np.float32, np.float64, np.int64, np.uint8, bool, complex, object, "U3"])
    shapes = [(), (0,), (3,), (10,), (72,), (0, 10), (1, 10), (2, 72), (1, 3), (5, 3), (1, 6890, 3)]
    shape = choose.choice([*shapes, (2, 6890, 3), (6890, 3), (1, 0, 3), (1, 1, 1, 1), (1, 18)])
    array = np.zeros(shape, dtype=dtype)
    if array.size and dtype in (np.float32, np.float64):
        array.reshape(-1)[choose.randrange(array.size)] = choose.choice([np.nan, np.inf, 1e30, -1])
    return choose.choice([array, array.T, array[::-1] if array.ndim else array, None, "text", [[]]])


def test_random_arguments(model):
    choose = random.Random(5)
    body = model.body
    calls = [
        lambda a: body(*a(5)),
        lambda a: body.unpose(*a(5)),
        lambda a: body.model.forward(*a(4)),
        lambda a: body.model.unpose(*a(4)),
        lambda a: body.model.pull_back(tuple(a(4)), *a(2)),
        lambda a: model.decode(*a(1), "longlong", *a(1)),
        lambda a: model.encode(*a(1), "longlong", *a(1)),
        lambda a: model.dress(*a(1), "longlong", *a(3)),
        lambda a: model.interpolate(*a(2), choose.choice([-1, 0, 2, 5])),
        lambda a: model.colours(*a(1), "longlong"),
        lambda a: model.transport(*a(1), "longlong", "shortlong"),
        lambda a: model._model.decode(*a(2), ["longlong"] * choose.randrange(3)),
        lambda a: model._model.pull_back(*a(2), ["longlong"] * choose.randrange(3), *a(1)),
        lambda a: cape.MeshPyramid(*a(2), choose.choice([[2], [0], [-1], [np.nan], [1e30], "x"])),
        lambda a: _cape.draw(*a(3), (choose.randrange(-1, 3), 10**6)),
        lambda a: _cape.encode_png(*a(1)),
        lambda a: _cape.save_mesh("nowhere.fbx", *a(2)),
        lambda a: _cape.save_mesh("/nowhere/mesh.ply", *a(3)),
        lambda a: cape.Mesh(*a(3)),
        lambda a: cape.Mesh.of(choose.choice([a(1)[0], a(2), tuple(a(2)), a(3)])),
        lambda a: cape.Mesh(*a(1), choose.choice([[[0, 0, 0]], [[0, 1, 2]], [[]], []]))._repr_html_(),
        lambda a: pictures.write_png("/nowhere/picture.png", *a(1)),
        lambda a: fit._keypoints(*a(1)),
        lambda a: fit._mask("mask", *a(1)),
        lambda a: fit._scan(choose.choice([a(1)[0], tuple(a(2))])),
        lambda a: toml({choose.choice(["a", 1, '"', ""]): choose.choice(a(1))}),
    ]
    refused = 0
    for _ in range(CALLS):
        call = choose.choice(calls)
        try:
            call(lambda n: [arrays(choose) for _ in range(n)])
        except EXPECTED:
            refused += 1
    assert 0.6 * CALLS < refused < CALLS


def test_meshes_that_are_none():
    points, triangle = np.eye(3), np.array([[0, 1, 2]])
    for vertices, faces, factors in [
        (points, triangle, [2]),
        (points, [[0, 1, 3]], [2]),
        (points, [[0, 0, 0]], [2]),
        (np.full((3, 3), np.nan), triangle, [2]),
        (np.zeros((3, 3)), triangle, [2]),
        (np.zeros((0, 3)), np.zeros((0, 3), dtype=int), [2]),
        (points, triangle, [0.5]),
        (points, triangle, [np.inf]),
        (points, triangle, [2] * 50),
        (points, [[-1, 0, 1]], [2]),
    ]:
        try:
            pyramid = cape.MeshPyramid(vertices, faces, factors)
        except cape.CapeError:
            continue
        with pytest.raises(cape.CapeError):
            pyramid.level(len(pyramid))


def test_broken_files(tmp_path):
    choose = random.Random(6)
    whole = tmp_path / "whole.npz"
    cape.create().model.save(whole)
    content = whole.read_bytes()
    for ending in (".npz", ".pkl", ".safetensors", ".txt"):
        for _ in range(20):
            broken = bytearray(content[: choose.randrange(len(content))])
            for _ in range(20):
                broken[choose.randrange(len(broken))] = choose.randrange(256)
            path = tmp_path / f"broken{ending}"
            path.write_bytes(broken)
            with pytest.raises(cape.CapeError):
                cape.load_smpl(path)
            with pytest.raises(cape.CapeError):
                cape.Model.load(path)


def test_broken_meshes(tmp_path):
    choose = random.Random(7)
    mesh = cape.create()().mesh()
    for ending in ("ply", "obj"):
        whole = tmp_path / f"whole.{ending}"
        mesh.save(whole)
        content = whole.read_bytes()
        for _ in range(30):
            broken = bytearray(content[: choose.randrange(2000, len(content))])
            for _ in range(50):
                broken[choose.randrange(choose.choice([200, len(broken)]))] = choose.randrange(256)
            path = tmp_path / f"broken.{ending}"
            path.write_bytes(broken)
            try:
                cape.Mesh.load(path)
            except cape.CapeError:
                pass


def test_options_of_all_kinds(tmp_path):
    """Values of keywords reach the program as its own errors."""
    choose = random.Random(8)
    values = ["", "x", -1, 1e400, [], ["a", None], {"a": 1}, b"x", object(), "--help", "\u00e9", "a\nb"]
    for name in ("frames", "clothing", "preset", "reference", "body", "threads", "gender"):
        with pytest.raises(cape.CapeError):
            cape.data.inspect(tmp_path / "nowhere", **{name: choose.choice(values)})
