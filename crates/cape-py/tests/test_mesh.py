"""Meshes: in other libraries, in files and in notebooks."""

import base64
import html
import json
import re

import numpy as np
import pytest

import cape
from browser import screenshot


@pytest.fixture(scope="module")
def model():
    return cape.Model.pretrained()


@pytest.fixture(scope="module")
def mesh(model):
    return model.sample("shortlong", pose="a-pose", seed=3).mesh()


def same(mesh, other, tolerance=0.0):
    np.testing.assert_allclose(mesh.vertices, other.vertices, atol=tolerance)
    np.testing.assert_array_equal(mesh.faces, other.faces)
    np.testing.assert_allclose(mesh.colours, other.colours, atol=0.5 / 255 + 1e-6)


def test_trimesh_and_back(mesh, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    theirs = mesh.to_trimesh()
    assert isinstance(theirs, trimesh.Trimesh) and theirs.is_watertight
    # Closed and with faces that look outwards: a person has a volume.
    assert 0.03 < theirs.volume < 0.15
    same(cape.Mesh.of(theirs), mesh)
    mesh.save(tmp_path / "mesh.ply")
    read = trimesh.load(tmp_path / "mesh.ply", process=False)
    same(cape.Mesh.of(read), mesh)
    theirs.export(tmp_path / "theirs.ply")
    np.testing.assert_allclose(cape.Mesh.load(tmp_path / "theirs.ply").vertices, mesh.vertices, atol=1e-7)
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert cape.Mesh.of(plain).colours is None


def test_meshio_and_back(mesh, tmp_path):
    meshio = pytest.importorskip("meshio")
    theirs = mesh.to_meshio()
    same(cape.Mesh.of(theirs), mesh)
    for ending in ("ply", "vtk", "obj"):
        path = tmp_path / f"mesh.{ending}"
        if ending == "vtk":
            theirs.write(path)
        else:
            mesh.save(path)
        read = cape.Mesh.of(meshio.read(path))
        np.testing.assert_allclose(read.vertices, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(read.faces, mesh.faces)
        if ending != "obj":
            same(read, mesh, 1e-6)
    with pytest.raises(cape.CapeError, match="triangle"):
        cape.Mesh.of(meshio.Mesh(mesh.vertices, [("line", [[0, 1]])]))


def test_files(mesh, tmp_path):
    for name in ("mesh.obj", "mesh.ply"):
        mesh.save(tmp_path / name)
        again = cape.Mesh.load(tmp_path / name)
        np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(again.faces, mesh.faces)
    mesh.save(tmp_path / "mesh.png")
    assert (tmp_path / "mesh.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(cape.FileError, match="nowhere"):
        cape.Mesh.load(tmp_path / "nowhere.obj")
    with pytest.raises(cape.CapeError, match="fbx"):
        mesh.save(tmp_path / "mesh.fbx")


def test_wrong_meshes_are_refused(mesh):
    points, faces = mesh.vertices, mesh.faces
    for arguments, message in [
        ((points[:, :2], faces), r"vertices: shape \[6890, 2\], expected \[n, 3\]"),
        ((points, faces[:, :2]), "faces: shape"),
        ((points[:5], faces), "faces: vertices 0 to 6889, but there are 5"),
        ((points, faces.astype(float)), "faces: numbers of type float64"),
        ((points, -faces.astype(int)), "faces: vertices -6889 to 0"),
        ((points * np.nan, faces), "vertices: not finite"),
        ((points, faces, points[:3]), "colours: 3 rows, expected 6890"),
        ((points, faces, 2 + 0 * points), "colours: expected numbers from 0 to 1"),
        ((np.zeros((0, 3)), faces), "vertices|faces"),
    ]:
        with pytest.raises(cape.CapeError, match=message):
            cape.Mesh(*arguments)
    for other in (None, 3, "mesh.obj", [1, 2, 3]):
        with pytest.raises(cape.CapeError):
            cape.Mesh.of(other)


def scene_of(page):
    """Scene of the page in the frame of ``_repr_html_``."""
    inner = html.unescape(re.search(r'srcdoc="([^"]*)"', page).group(1))
    return json.loads(re.search(r'application/json">(.*?)</script>', inner, re.S).group(1))


def array(text, dtype):
    return np.frombuffer(base64.b64decode(text), dtype).reshape(-1, 3)


def test_the_page_has_the_mesh(mesh):
    scene = scene_of(mesh._repr_html_())
    body = scene["bodies"][0]
    points = np.array(scene["low"]) + np.array(scene["step"]) * array(body["vertices"], "<u2")
    np.testing.assert_allclose(points, mesh.vertices, atol=2e-5)
    np.testing.assert_array_equal(array(scene["faces"], "<u2"), mesh.faces)
    np.testing.assert_allclose(array(body["colours"], np.uint8) / 255, mesh.colours, atol=2e-3)


def test_bodies_of_a_page_stand_beside_each_other(model):
    dressed = model.sample("longlong", n=10, seed=2)
    scene = scene_of(dressed._repr_html_())
    low, step = np.array(scene["low"]), np.array(scene["step"])
    bodies = [low + step * array(body["vertices"], "<u2") for body in scene["bodies"]]
    assert len(bodies) == 8
    for left, right in zip(bodies, bodies[1:]):
        assert left[:, 0].max() < right[:, 0].min()
    for body, vertices in zip(bodies, dressed.vertices):
        np.testing.assert_allclose(body[:, 1:], vertices[:, 1:], atol=2e-4)


def test_meshes_of_all_sizes_have_pages():
    square = cape.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    assert scene_of(square._repr_html_())["wide"] is False
    big = cape.Mesh(np.random.default_rng(0).normal(size=(70_000, 3)), [[0, 1, 69_999]])
    scene = scene_of(big._repr_html_())
    assert scene["wide"] and array(scene["faces"], "<u4").tolist() == [[0, 1, 69_999]]
    points = cape.Mesh([[0, 0, 0], [1, 1, 1]], np.zeros((0, 3), int))
    assert scene_of(points._repr_html_())["faces"] == ""


def test_a_browser_shows_it(mesh, tmp_path):
    (tmp_path / "page.html").write_text(f"<body style='margin:0'>{mesh._repr_html_()}")
    shot = screenshot((tmp_path / "page.html").as_uri(), tmp_path, 500, 420)
    background = shot[200, 5].astype(int)
    drawn = np.abs(shot.astype(int) - background).max(axis=-1) > 24
    # A person: some of the picture, nearly symmetric about its middle, higher than wide.
    rows, columns = np.nonzero(drawn[:380])
    assert 0.05 < drawn.mean() < 0.5
    assert np.ptp(rows) > 250 and np.ptp(rows) > np.ptp(columns)
    assert abs(columns.mean() - 250) < 40
    # Skin and cloth are of different colours.
    colours = shot[drawn].astype(int)
    redness = colours[:, 0] - colours[:, 2]
    assert np.percentile(redness, 95) - np.percentile(redness, 5) > 40


def test_a_notebook_shows_bodies(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    nbconvert = pytest.importorskip("nbconvert")
    pytest.importorskip("ipykernel")
    cells = ["import cape\nmodel = cape.Model.pretrained()", 'model.sample("longlong", n=3, pose="walk")']
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbconvert.preprocessors.ExecutePreprocessor(timeout=120).preprocess(notebook, {})
    kinds = notebook.cells[1].outputs[0].data
    assert "srcdoc" in kinds["text/html"] and "image/png" in kinds
    page, _ = nbconvert.HTMLExporter().from_notebook_node(notebook)
    (tmp_path / "notebook.html").write_text(page)
    shot = screenshot((tmp_path / "notebook.html").as_uri(), tmp_path, 900, 760)
    frame = shot[240:640].astype(int)
    assert (np.abs(frame - frame[5, 450]).max(axis=-1) > 24).mean() > 0.05
