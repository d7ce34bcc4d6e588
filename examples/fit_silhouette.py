"""Fits a latent code to a silhouette by an optimiser of PyTorch, with cape's gradients.

    python examples/fit_silhouette.py

The silhouette is that of a sampled body seen from the front. Vertices are drawn into it by its distance
transform, and its outline draws the vertices nearest to it. Prints the mean distance of the vertices to
those of the body before and after. Needs PyTorch and SciPy.
"""

import numpy as np
import torch
from scipy.ndimage import binary_erosion, distance_transform_edt

import cape
import cape.torch

PIXELS = 384
METRES = 2.4


def project(points):
    """Orthographic projection of points [..., 3] to pixels [..., 2], from the left and from above."""
    scale = PIXELS / METRES
    x, y = points[..., 0] * scale, (0.3 + points[..., 1]) * -scale
    stack = torch.stack if isinstance(points, torch.Tensor) else np.stack
    return stack([x, y], -1) + PIXELS / 2


def silhouette(vertices, faces):
    """Pixels that a surface covers, from many points on it."""
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), size=(len(faces), 40)).astype(np.float32)
    points = np.einsum("fpk,fkc->fpc", weights, vertices[faces])
    columns, rows = project(points).reshape(-1, 2).astype(int).T
    mask = np.zeros((PIXELS, PIXELS), dtype=bool)
    mask[rows, columns] = True
    return mask


model = cape.Model.pretrained()
person = model.sample("longlong", pose="a-pose", seed=11)
mask = silhouette(person.vertices[0], person.faces)
outside = torch.from_numpy(distance_transform_edt(~mask)).float()[None, None]
outline = torch.from_numpy(np.argwhere(mask & ~binary_erosion(mask))[::4, ::-1].copy()).float() + 0.5

dress = cape.torch.Dress(model, "longlong")
pose = torch.from_numpy(cape.poses("a-pose"))
target = torch.from_numpy(person.vertices)
codes = torch.zeros(1, model.latent, requires_grad=True)
optimiser = torch.optim.Adam([codes], lr=0.1)
for step in range(60):
    optimiser.zero_grad()
    vertices = dress(codes, pose=pose).vertices
    pixels = project(vertices)
    places = (2 * pixels / PIXELS - 1)[:, None]
    distance = torch.nn.functional.grid_sample(outside, places, align_corners=False)
    missing = torch.cdist(outline, pixels[0]).min(dim=1).values
    loss = distance.square().mean() + missing.square().mean() + 0.01 * codes.square().mean()
    loss.backward()
    optimiser.step()
    error = 1e3 * (vertices - target).norm(dim=-1)[:, model.clothing].mean().item()
    if step in (0, 59):
        print(f"step {step + 1}: loss {loss.item():.3f}, error of clothed vertices {error:.2f} mm")
