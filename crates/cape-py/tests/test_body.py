"""Bodies and pyramids against closed forms and smplx."""

import numpy as np
import pytest

import cape


@pytest.fixture(scope="module")
def body():
    return cape.create(gender="female")


def parameters(n, seed=0):
    rng = np.random.default_rng(seed)
    return {
        "betas": rng.normal(size=(n, 10)).astype(np.float32),
        "body_pose": rng.normal(scale=0.3, size=(n, 69)).astype(np.float32),
        "global_orient": rng.normal(size=(n, 3)).astype(np.float32),
        "transl": rng.normal(size=(n, 3)).astype(np.float32),
    }


def test_rest_body_is_the_template_moved(body):
    out = body(transl=[[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(out.vertices[0], body.model.v_template + [1, 2, 3], atol=1e-5)


def test_unposing_returns_shape_and_displacement(body):
    given = parameters(3)
    displacement = np.full((3, 6890, 3), 0.01, dtype=np.float32)
    posed = body(**given, displacement=displacement).vertices
    shape = body.model.v_template + np.einsum("vkb,nb->nvk", body.model.shapedirs, given["betas"])
    np.testing.assert_allclose(body.unpose(posed, **given), shape + displacement, atol=2e-5)


def test_batch_equals_its_rows(body):
    given = parameters(3)
    together = body(**given).vertices
    for i in range(3):
        alone = body(**{name: value[i] for name, value in given.items()}).vertices[0]
        np.testing.assert_allclose(together[i], alone, atol=1e-6)


def test_saved_body_is_read_from_a_folder(body, tmp_path):
    (tmp_path / "smpl").mkdir()
    body.model.save(tmp_path / "smpl" / "SMPL_FEMALE.npz")
    again = cape.create(tmp_path, gender="female")
    np.testing.assert_array_equal(again.model.v_template, body.model.v_template)
    with pytest.raises(cape.FileError, match="SMPL_MALE"):
        cape.create(tmp_path, gender="male")


def test_wrong_arguments_are_refused(body):
    with pytest.raises(cape.CapeError, match=r"betas: shape \[1, 3\], expected \[n, 10\]"):
        body(betas=[[0, 0, 0]])
    with pytest.raises(cape.CapeError, match="transl: 2 rows, expected 1 or 3"):
        body(betas=np.zeros((3, 10)), transl=np.zeros((2, 3)))
    with pytest.raises(cape.CapeError, match=r"betas: shape \[0, 10\], expected \[n, 0 to 10\]"):
        body.model.forward(*(np.zeros((0, k), dtype=np.float32) for k in (10, 72, 3)))
    with pytest.raises(cape.CapeError, match="pose: shape .* expected .1, 72."):
        body.model.forward(*(np.zeros((1, k), dtype=np.float32) for k in (10, 71, 3)))
    with pytest.raises(cape.CapeError, match="betas: an array of int64"):
        body.model.forward(*(np.zeros((1, k), dtype=np.int64) for k in (10, 72, 3)))
    with pytest.raises(cape.CapeError, match="transl: not finite"):
        body(transl=[[0, np.nan, 0]])
    with pytest.raises(cape.CapeError, match="betas: not finite"):
        body(betas=[[1e300] * 10])
    with pytest.raises(cape.CapeError, match="betas: numbers of type complex128"):
        body(betas=[[1j] * 10])
    with pytest.raises(cape.CapeError, match="num_betas"):
        cape.create(num_betas=-1)
    with pytest.raises(cape.FileError):
        cape.load_smpl("nowhere.pkl")


def test_memory_order_does_not_matter(body):
    given = parameters(4)
    expected = body(**given).vertices
    strided = {name: np.repeat(value, 2, axis=1)[:, ::2] for name, value in given.items()}
    fortran = {name: np.asfortranarray(value) for name, value in given.items()}
    for other in (strided, fortran):
        np.testing.assert_array_equal(body(**other).vertices, expected)
    read_only = given["betas"].copy()
    read_only.flags.writeable = False
    given["betas"] = read_only
    np.testing.assert_array_equal(body(**given).vertices, expected)


def test_double_precision_agrees_with_single(body):
    given = parameters(2)
    pose = np.concatenate([given["global_orient"], given["body_pose"]], axis=1)
    arrays = [array.astype(np.float64) for array in (given["betas"], pose, given["transl"])]
    vertices, joints = body.model.forward(*arrays)
    assert vertices.dtype == joints.dtype == np.float64
    np.testing.assert_allclose(body(**given).vertices, vertices, atol=2e-6)


def test_many_bodies(body):
    shapes = np.random.default_rng(1).normal(size=(1030, 10)).astype(np.float32)
    vertices = body(betas=shapes).vertices
    np.testing.assert_allclose(vertices[1027], body(betas=shapes[1027]).vertices[0], atol=1e-6)


def test_same_vertices_and_joints_as_smplx(body, tmp_path):
    smplx = pytest.importorskip("smplx")
    torch = pytest.importorskip("torch")
    path = tmp_path / "SMPL_FEMALE.npz"
    body.model.save(path)
    try:
        peer = smplx.SMPL(str(path), gender="female", batch_size=4)
    except Exception:
        import pickle

        with np.load(path, allow_pickle=False) as arrays:
            path = path.with_suffix(".pkl")
            path.write_bytes(pickle.dumps(dict(arrays)))
        peer = smplx.SMPL(str(path), gender="female", batch_size=4)
    given = parameters(4)
    theirs = peer(**{name: torch.from_numpy(value) for name, value in given.items()})
    ours = body(**given)
    np.testing.assert_allclose(ours.vertices, theirs.vertices.detach().numpy(), atol=1e-5)
    np.testing.assert_allclose(ours.joints, theirs.joints.detach().numpy()[:, :24], atol=1e-5)


def test_pyramid_matrices(body):
    pytest.importorskip("scipy")
    pyramid = cape.MeshPyramid(body.model.v_template, body.faces, [2, 2])
    assert [len(pyramid.level(i)[0]) for i in range(len(pyramid))] == [6890, 3445, 1723]
    for i in range(2):
        fine, coarse = pyramid.level(i)[0], pyramid.level(i + 1)[0]
        np.testing.assert_allclose(pyramid.down(i) @ fine, coarse, atol=1e-12)
        np.testing.assert_allclose(pyramid.up(i).sum(axis=1), 1.0, atol=1e-9)
    assert abs(pyramid.laplacian(0) - pyramid.laplacian(0).T).max() < 1e-12
    with pytest.raises(cape.CapeError):
        cape.MeshPyramid(body.model.v_template, body.faces, [0.5])
