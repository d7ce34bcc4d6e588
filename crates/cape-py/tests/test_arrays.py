"""Arrays of other libraries go in and out without copies."""

import numpy as np
import pytest

import cape
from cape import _arrays


@pytest.fixture(scope="module")
def body():
    return cape.create()


def address(array):
    return array.__array_interface__["data"][0]


def test_arrays_of_jax(body):
    jax = pytest.importorskip("jax")
    betas = jax.numpy.asarray(np.random.default_rng(0).normal(size=(3, 10)).astype(np.float32))
    taken = _arrays.floats("betas", betas)
    assert address(taken) == betas.unsafe_buffer_pointer()
    vertices = body(betas=betas).vertices
    np.testing.assert_array_equal(vertices, body(betas=np.asarray(betas)).vertices)
    given = jax.numpy.from_dlpack(vertices)
    np.testing.assert_array_equal(given, vertices)
    # JAX copies what does not lie at a multiple of 64 bytes.
    if address(vertices) % 64 == 0:
        assert given.unsafe_buffer_pointer() == address(vertices)
    # Traced arrays have no values.
    with pytest.raises(cape.CapeError, match="betas"):
        jax.jit(lambda betas: body(betas=betas).vertices)(betas)


def test_jax_differentiates_through_a_callback(body):
    """The gradient of the body in JAX, by its own mechanism for functions of the host."""
    jax = pytest.importorskip("jax")
    numpy = jax.numpy
    shape = jax.ShapeDtypeStruct((1, 6890, 3), np.float32)

    def forward(betas):
        return body(betas=betas).vertices

    def pull_back(betas, by_vertex):
        zero = np.zeros((1, 3), np.float32)
        given = (np.asarray(betas), np.zeros((1, 72), np.float32), zero, None)
        joints = np.zeros((1, 24, 3), np.float32)
        return body.model.pull_back(given, np.asarray(by_vertex), joints)[0]

    @jax.custom_vjp
    def posed(betas):
        return jax.pure_callback(forward, shape, betas)

    posed.defvjp(
        lambda betas: (posed(betas), betas),
        lambda betas, g: (jax.pure_callback(pull_back, jax.ShapeDtypeStruct((1, 10), np.float32), betas, g),),
    )
    weights = np.random.default_rng(1).normal(size=(1, 6890, 3)).astype(np.float32)
    betas = numpy.zeros((1, 10), np.float32)
    found = jax.grad(lambda betas: (posed(betas) * weights).sum())(betas)
    # The template moves linearly with the coefficients.
    expected = np.einsum("vkb,nvk->nb", body.model.shapedirs, weights)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3)


def test_tensors_of_pytorch(body):
    torch = pytest.importorskip("torch")
    betas = torch.randn(3, 10)
    assert address(_arrays.floats("betas", betas)) == betas.data_ptr()
    vertices = body(betas=betas).vertices
    assert torch.from_numpy(vertices).data_ptr() == address(vertices)
    with pytest.raises(cape.CapeError, match="betas.*grad"):
        body(betas=betas.requires_grad_())


def test_results_are_writeable_and_of_their_own(body):
    first = body(transl=[[0, 0, 1]])
    before = first.vertices.copy()
    body(transl=[[0, 0, 2]])
    np.testing.assert_array_equal(first.vertices, before)
    first.vertices[0, 0] = 0


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int8, np.uint32, bool])
def test_numbers_of_all_types(body, dtype):
    betas = np.ones((1, 10), dtype=dtype)
    np.testing.assert_array_equal(body(betas=betas).vertices, body(betas=[[1.0] * 10]).vertices)
