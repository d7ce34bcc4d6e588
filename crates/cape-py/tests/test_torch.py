"""Gradients of the PyTorch layers against finite differences."""

import numpy as np
import pytest

import cape

torch = pytest.importorskip("torch")
layers = pytest.importorskip("cape.torch")


@pytest.fixture(scope="module")
def model():
    return cape.Model.pretrained()


def random_tensor(shape, scale, seed, dtype=torch.float64):
    values = np.random.default_rng(seed).normal(scale=scale, size=shape)
    return torch.from_numpy(values).to(dtype).requires_grad_()


def test_values_are_those_of_numpy(model):
    body = layers.SMPL(model.body)
    betas = random_tensor((3, 10), 1, 0, torch.float32)
    transl = random_tensor((1, 3), 1, 1, torch.float32)
    posed = body(betas=betas, transl=transl)
    expected = model.body(betas=betas.detach(), transl=transl.detach())
    np.testing.assert_array_equal(posed.vertices.detach(), expected.vertices)
    np.testing.assert_array_equal(posed.joints.detach(), expected.joints)
    dress = layers.Dress(model, "longlong")
    codes = model.codes("longlong", n=2, seed=4)
    clothed = dress(torch.from_numpy(codes), betas=betas[:2])
    expected = model.dress(codes, "longlong", betas=betas[:2].detach())
    np.testing.assert_allclose(clothed.vertices.detach(), expected.vertices, atol=1e-6)


def test_gradients_of_the_body_in_double_precision(model):
    body = layers.SMPL(model.body)
    rng = np.random.default_rng(2)
    by_vertex, by_joint = (torch.from_numpy(rng.normal(size=(2, k, 3))) for k in (6890, 24))
    # One point of cloth moves: the whole displacement would need 41340 evaluations.
    basis = torch.from_numpy(rng.normal(size=(2, 6890, 3)))

    def projected(betas, body_pose, global_orient, transl, amount):
        posed = body(betas, body_pose, global_orient, transl, amount * basis)
        return (posed.vertices * by_vertex).sum() + (posed.joints * by_joint).sum()

    given = (
        random_tensor((2, 10), 1, 3),
        random_tensor((2, 69), 0.4, 4),
        random_tensor((1, 3), 1, 5),
        random_tensor((2, 3), 1, 6),
        random_tensor((2, 1, 1), 0.01, 7),
    )
    assert torch.autograd.gradcheck(projected, given, eps=1e-6, atol=1e-5, rtol=1e-6)


def test_gradients_at_the_rest_pose(model):
    body = layers.SMPL(model.body)
    pose = torch.zeros(1, 69, dtype=torch.float64, requires_grad=True)
    by_vertex = torch.from_numpy(np.random.default_rng(0).normal(size=(1, 6890, 3)))
    check = lambda pose: (body(body_pose=pose).vertices * by_vertex).sum()  # noqa: E731
    assert torch.autograd.gradcheck(check, (pose,), eps=1e-6, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize("name", ["codes", "pose", "betas", "transl"])
def test_gradients_of_clothing(model, name):
    """Along a random direction, by central differences; in single precision."""
    dress = layers.Dress(model, ["longlong", "shortlong"])
    rng = np.random.default_rng(8)
    given = {
        "codes": random_tensor((2, model.latent), 1, 9, torch.float32),
        "pose": random_tensor((2, 72), 0.3, 10, torch.float32),
        "betas": random_tensor((2, 10), 1, 11, torch.float32),
        "transl": random_tensor((2, 3), 1, 12, torch.float32),
    }
    weights = torch.from_numpy(rng.normal(size=(2, 6890, 3)))

    def projected(step, direction):
        moved = {**given, name: given[name] + step * direction}
        return (dress(**moved).vertices.double() * weights).sum()

    projected(0, 0).backward()
    gradient = given[name].grad.double()
    direction = (gradient / gradient.norm()).float()
    step = 1e-2
    with torch.no_grad():
        difference = (projected(step, direction) - projected(-step, direction)) / (2 * step)
    np.testing.assert_allclose(difference, (gradient * direction).sum(), rtol=1e-2)


def test_codes_are_fitted_to_a_dressed_body(model):
    dress = layers.Dress(model, "longlong")
    target = torch.from_numpy(model.sample("longlong", seed=5).vertices)
    codes = torch.zeros(1, model.latent, requires_grad=True)
    optimiser = torch.optim.Adam([codes], lr=0.1)
    losses = []
    for _ in range(30):
        optimiser.zero_grad()
        loss = (dress(codes).vertices - target).square().sum(-1).mean()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.2 * losses[0]


def test_wrong_tensors_are_refused(model):
    body, dress = layers.SMPL(model.body), layers.Dress(model, "longlong")
    with pytest.raises(cape.CapeError, match=r"betas: shape \[10\], expected \[n, 10\]"):
        body(betas=torch.zeros(10))
    with pytest.raises(cape.CapeError, match="betas: torch.int64"):
        body(betas=torch.zeros(1, 10, dtype=torch.int64))
    with pytest.raises(cape.CapeError, match="codes: not finite"):
        dress(torch.full((1, model.latent), float("nan")))
    with pytest.raises(cape.CapeError, match="transl: 3 rows, expected 1 or 2|2 rows"):
        dress(torch.zeros(2, model.latent), transl=torch.zeros(3, 3))
