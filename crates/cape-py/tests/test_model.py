"""The built-in model from Python."""

import numpy as np
import pytest

import cape


@pytest.fixture(scope="module")
def model():
    return cape.Model.pretrained()


def test_samples_are_dressed_bodies(model):
    pose = np.zeros(72, dtype=np.float32)
    pose[3 * 16 + 2] = -0.8
    dressed = model.sample("shortlong", n=2, pose=pose, seed=7)
    assert dressed.vertices.shape == dressed.displacement.shape == (2, 6890, 3)
    # The clothing term of the body: the same vertices by the body with the displacements.
    worn = np.zeros_like(dressed.displacement)
    worn[:, model.clothing] = dressed.displacement[:, model.clothing]
    posed = model.body(body_pose=pose[None, 3:], displacement=worn).vertices
    np.testing.assert_allclose(dressed.vertices, posed, atol=1e-5)
    again = model.sample("shortlong", n=2, pose=pose, seed=7)
    np.testing.assert_array_equal(again.vertices, dressed.vertices)


def test_codes_come_back_near_what_they_decode_to(model):
    displacement = model.sample("longlong", n=3, seed=2).displacement
    again = model.decode(model.encode(displacement, "longlong"), "longlong")
    worn = displacement[:, model.clothing]
    error = np.linalg.norm(again[:, model.clothing] - worn, axis=-1).mean()
    assert error < 0.5 * np.linalg.norm(worn, axis=-1).mean()


def test_batches_equal_their_rows(model):
    codes = model.sample("shortshort", n=5, seed=3).codes
    outfits = ["shortshort", "longlong", "shortlong", "longshort", "longlong"]
    together = model.decode(codes, outfits)
    for row, outfit in enumerate(outfits):
        np.testing.assert_allclose(together[row], model.decode(codes[row], outfit)[0], atol=1e-6)
    between = model.interpolate(codes[0], codes[1], 3)
    np.testing.assert_allclose(between[1], codes[:2].mean(axis=0), atol=1e-6)


def test_wrong_arguments_are_refused(model):
    with pytest.raises(cape.CapeError, match="outfit"):
        model.sample("pyjamas")
    with pytest.raises(cape.CapeError, match=r"codes: shape \[1, 3\]"):
        model.decode([[0, 0, 0]], "longlong")
    with pytest.raises(cape.CapeError, match="outfits: 2 rows, expected 1"):
        model.decode(np.zeros((1, model.latent)), ["longlong", "shortlong"])
    with pytest.raises(cape.CapeError, match="temperature"):
        model.sample("longlong", temperature=-1)
    with pytest.raises(cape.FileError):
        cape.Model.load("nowhere.safetensors")
