"""The built-in model from Python."""

import numpy as np
import pytest

import cape
from cape import _cape


@pytest.fixture(scope="module")
def model():
    return cape.Model.pretrained()


def obj_vertices(path):
    lines = path.read_text().splitlines()
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=float)


def test_samples_are_those_of_the_command(model, tmp_path):
    out = tmp_path / "out"
    options = ["--outfit", "shortlong", "-n", "2", "--seed", "7", "--pose", "walk", "--no-picture"]
    assert _cape.main(["cape", "sample", *options, "--quiet", "--out", str(out)]) == 0
    dressed = model.sample("shortlong", n=2, pose="walk", seed=7)
    files = sorted(out.rglob("*.obj"))
    assert len(files) == len(dressed) == 2
    for file, vertices in zip(files, dressed.vertices):
        np.testing.assert_allclose(obj_vertices(file), vertices, atol=2e-6)


def test_poses_have_names_and_files(model, tmp_path):
    walk, a_pose = cape.poses("walk"), cape.poses("a-pose")
    assert walk.shape == a_pose.shape == (1, 72)
    assert a_pose[0, 3 * 16 + 2] == -a_pose[0, 3 * 17 + 2] < 0
    both = np.concatenate([walk, a_pose])
    np.save(tmp_path / "both.npy", both)
    np.testing.assert_allclose(cape.poses(tmp_path / "both.npy"), both, atol=1e-6)
    assert len(model.sample("longlong", pose=tmp_path / "both.npy", n=1)) == 2
    with pytest.raises(cape.CapeError, match="moonwalk"):
        model.sample("longlong", pose="moonwalk")


def test_nothing_is_worn_beside_the_clothing(model):
    dressed = model.sample("longlong", seed=3)
    bare = np.setdiff1d(np.arange(len(model.body.model.v_template)), model.clothing)
    assert not dressed.displacement[:, bare].any()
    unclothed = model.body().vertices[0]
    np.testing.assert_allclose(dressed.vertices[0, bare], unclothed[bare], atol=1e-6)
    assert np.linalg.norm(dressed.vertices[0] - unclothed, axis=1).max() > 0.01


def test_codes_come_back_near_what_they_decode_to(model):
    displacement = model.sample("longlong", n=3, seed=2).displacement
    again = model.decode(model.encode(displacement, "longlong"), "longlong")
    worn = displacement[:, model.clothing]
    error = np.linalg.norm(again[:, model.clothing] - worn, axis=-1).mean()
    assert error < 0.5 * np.linalg.norm(worn, axis=-1).mean()


def test_batches_equal_their_rows(model):
    codes = model.codes("shortshort", n=70, seed=3)
    outfits = ["shortshort", "longlong", "shortlong", "longshort", "longlong"] * 14
    together = model.decode(codes, outfits)
    for row in (0, 3, 63, 64, 69):
        alone = model.decode(codes[row], outfits[row])[0]
        np.testing.assert_allclose(together[row], alone, atol=1e-6)
    between = model.interpolate(codes[0], codes[1], 3)
    np.testing.assert_allclose(between, [codes[0], codes[:2].mean(axis=0), codes[1]], atol=1e-6)


def test_codes_of_another_outfit(model):
    codes = model.codes("longlong", n=200, seed=5)
    moved = model.transport(codes, "longlong", "shortshort")
    np.testing.assert_allclose(model.transport(moved, "shortshort", "longlong"), codes, atol=1e-3)
    own = model.codes("shortshort", n=2000, seed=1)
    assert np.linalg.norm(moved.mean(axis=0) - own.mean(axis=0)) < 0.3 * np.linalg.norm(
        codes.mean(axis=0) - own.mean(axis=0)
    )
    with pytest.raises(cape.CapeError, match="poloshort"):
        model.transport(codes, "longlong", "poloshort")


def test_a_picture_and_a_mesh_are_written(model, tmp_path):
    dressed = model.sample("shortlong", n=2, seed=1)
    pixels = dressed.picture(size=(60, 80))
    assert pixels.shape == (80, 120, 4) and pixels.dtype == np.uint8
    centre, corner = pixels[40, 30], pixels[0, 0]
    assert np.abs(centre.astype(int) - corner).max() > 20
    dressed.save(tmp_path / "dressed.png")
    assert (tmp_path / "dressed.png").read_bytes() == dressed._repr_png_()
    assert dressed._repr_png_().startswith(b"\x89PNG")
    dressed.save(tmp_path / "dressed.obj", index=1)
    saved = obj_vertices(tmp_path / "dressed.obj")
    np.testing.assert_allclose(saved, dressed.vertices[1], atol=1e-6)
    assert dressed.colours(1).shape == (len(saved), 3)
    with pytest.raises(cape.CapeError):
        dressed.save(tmp_path / "dressed.fbx")


def test_wrong_arguments_are_refused(model):
    with pytest.raises(cape.CapeError, match="outfit"):
        model.sample("pyjamas")
    with pytest.raises(cape.CapeError, match="n 0"):
        model.sample("longlong", n=0)
    with pytest.raises(cape.CapeError, match="expected 1 to 1048576"):
        model.sample("longlong", n=10**15)
    with pytest.raises(cape.CapeError, match="seed -1"):
        model.sample("longlong", seed=-1)
    with pytest.raises(cape.CapeError, match=r"codes: shape \[1, 3\]"):
        model.decode([[0, 0, 0]], "longlong")
    with pytest.raises(cape.CapeError, match="codes: not finite"):
        model.decode(np.full(model.latent, np.inf), "longlong")
    with pytest.raises(cape.CapeError, match="outfits: 2 names, expected 1"):
        model.decode(np.zeros((1, model.latent)), ["longlong", "shortlong"])
    with pytest.raises(cape.CapeError, match="temperature"):
        model.sample("longlong", temperature=-1)
    with pytest.raises(cape.CapeError, match="displacement: not finite"):
        model.encode(np.full((6890, 3), np.nan), "longlong")
    with pytest.raises(cape.FileError):
        cape.Model.load("nowhere.safetensors")
