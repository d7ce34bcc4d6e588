"""SMPL and clothing models as layers of PyTorch.

Values and gradients are computed by cape on the CPU; tensors of other devices are copied there and
back. Derivatives are of the first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from . import _cape
from ._arrays import batches
from .body import Body
from .model import Model, outfit_names

#: Codes whose gradients are computed in one call of the library.
_BATCH = 16


class Posed(NamedTuple):
    """Posed bodies: ``vertices`` [n, V, 3] and ``joints`` [n, J, 3], metres."""

    vertices: Tensor
    joints: Tensor


class Clothed(NamedTuple):
    """Dressed bodies, metres: ``vertices`` [n, V, 3], ``joints`` [n, J, 3], and ``displacement``
    [n, V, 3] in the rest pose, zero where nothing is worn."""

    vertices: Tensor
    joints: Tensor
    displacement: Tensor


class SMPL(torch.nn.Module):
    """SMPL body, differentiable in all its arguments, in single or double precision.

    ``body`` is one of :func:`cape.create`.
    """

    def __init__(self, body: Body) -> None:
        super().__init__()
        self.body = body

    def forward(
        self,
        betas: Tensor | None = None,
        body_pose: Tensor | None = None,
        global_orient: Tensor | None = None,
        transl: Tensor | None = None,
        displacement: Tensor | None = None,
    ) -> Posed:
        """Pose bodies, as :meth:`cape.Body.__call__`; tensors of one row are repeated."""
        joints, vertices = self.body.num_joints, self.body.num_vertices
        shapes: dict[str, tuple[Tensor | None, tuple[int, ...]]] = {
            "betas": (betas, (self.body.num_betas,)),
            "body_pose": (body_pose, (3 * (joints - 1),)),
            "global_orient": (global_orient, (3,)),
            "transl": (transl, (3,)),
        }
        if displacement is not None:
            shapes["displacement"] = (displacement, (vertices, 3))
        rows = _rows(shapes)
        pose = torch.cat([rows["global_orient"], rows["body_pose"]], dim=1)
        posed = _Pose.apply(
            self.body.model, rows["betas"], pose, rows["transl"], rows.get("displacement")
        )
        return Posed(*posed)


class Dress(torch.nn.Module):
    """Clothing of a model on its body, differentiable in codes, poses, shapes and translations.

    ``outfit`` is one name, or one for each body. In single precision.
    """

    worn: Tensor

    def __init__(self, model: Model, outfit: str | Sequence[str]) -> None:
        super().__init__()
        self.model = model
        self.outfit = outfit
        self.body = SMPL(model.body)
        worn = torch.zeros(model.body.num_vertices, 1)
        worn[torch.from_numpy(model.clothing)] = 1
        self.register_buffer("worn", worn, persistent=False)

    def forward(
        self,
        codes: Tensor,
        pose: Tensor | None = None,
        betas: Tensor | None = None,
        transl: Tensor | None = None,
    ) -> Clothed:
        """Dress bodies: ``codes`` [n, latent], ``pose`` [n, 72], radians, ``betas`` [n, b],
        ``transl`` [n, 3], metres; zero if left out, repeated if of one row."""
        shapes: dict[str, tuple[Tensor | None, tuple[int, ...]]] = {
            "codes": (codes, (self.model.latent,)),
            "pose": (pose, (3 * self.model.body.num_joints,)),
            "betas": (betas, (self.model.body.num_betas,)),
            "transl": (transl, (3,)),
        }
        rows = {name: value.to(torch.float32) for name, value in _rows(shapes).items()}
        outfits = outfit_names(self.outfit, len(rows["codes"]))
        decoded = _Decode.apply(self.model, rows["codes"], rows["pose"], outfits)
        displacement = decoded * self.worn.to(decoded.device)
        pose_ = rows["pose"]
        posed = self.body(rows["betas"], pose_[:, 3:], pose_[:, :3], rows["transl"], displacement)
        return Clothed(posed.vertices, posed.joints, displacement)


class _Pose(torch.autograd.Function):
    """Vertices and joints of bodies."""

    @staticmethod
    def forward(
        ctx: Any,
        model: _cape.SmplModel,
        betas: Tensor,
        pose: Tensor,
        transl: Tensor,
        displacement: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        ctx.model = model
        ctx.save_for_backward(betas, pose, transl, displacement)
        given = [_array(tensor) for tensor in (betas, pose, transl, displacement)]
        vertices, joints = model.forward(*given)
        return _tensor(vertices, betas), _tensor(joints, betas)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, vertices: Tensor, joints: Tensor) -> tuple[Tensor | None, ...]:
        given = [_array(tensor) for tensor in ctx.saved_tensors]
        by_vertex, by_joint = _array(vertices), _array(joints)
        pulled: list[Any] = [None if array is None else np.empty_like(array) for array in given]
        for rows in batches(len(by_vertex)):
            part = tuple(None if array is None else array[rows] for array in given)
            gradients = ctx.model.pull_back(part, by_vertex[rows], by_joint[rows])
            for whole, gradient in zip(pulled, gradients):
                if whole is not None:
                    whole[rows] = gradient
        return (None, *(None if array is None else _tensor(array, vertices) for array in pulled))


class _Decode(torch.autograd.Function):
    """Displacements of codes, poses and outfits."""

    @staticmethod
    def forward(
        ctx: Any, model: Model, codes: Tensor, pose: Tensor, outfits: list[str]
    ) -> Tensor:
        ctx.model, ctx.outfits = model, outfits
        ctx.save_for_backward(codes, pose)
        return _tensor(model.decode(_array(codes), outfits, _array(pose)), codes)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, displacement: Tensor) -> tuple[Tensor | None, ...]:
        codes, pose = (_array(tensor) for tensor in ctx.saved_tensors)
        by_vertex = _array(displacement)
        by_code, by_pose = np.empty_like(codes), np.empty_like(pose)
        for rows in batches(len(codes), _BATCH):
            by_code[rows], by_pose[rows] = ctx.model._model.pull_back(
                codes[rows], pose[rows], ctx.outfits[rows], by_vertex[rows]
            )
        return None, _tensor(by_code, displacement), _tensor(by_pose, displacement), None


def _rows(shapes: dict[str, tuple[Tensor | None, tuple[int, ...]]]) -> dict[str, Tensor]:
    """Tensors of as many rows as the longest, in its precision and on its device."""
    given = {name: tensor for name, (tensor, _) in shapes.items() if tensor is not None}
    for name, tensor in given.items():
        if not isinstance(tensor, Tensor) or tensor.dtype not in (torch.float32, torch.float64):
            found = tensor.dtype if isinstance(tensor, Tensor) else type(tensor).__name__
            raise _cape.CapeError(f"{name}: {found}, expected a tensor of float32 or float64")
        shape = shapes[name][1]
        if tensor.ndim != len(shape) + 1 or tuple(tensor.shape[1:]) != shape or len(tensor) == 0:
            expected = ", ".join(["n", *map(str, shape)])
            raise _cape.CapeError(f"{name}: shape {list(tensor.shape)}, expected [{expected}]")
    longest = max(given.values(), key=len, default=torch.zeros(1))
    double = any(tensor.dtype == torch.float64 for tensor in given.values())
    dtype = torch.float64 if double else torch.float32
    rows = {}
    for name, (_, shape) in shapes.items():
        tensor = given.get(name, torch.zeros(1, *shape))
        if len(tensor) not in (1, len(longest)):
            raise _cape.CapeError(f"{name}: {len(tensor)} rows, expected 1 or {len(longest)}")
        rows[name] = tensor.to(longest.device, dtype).expand(len(longest), *shape)
    return rows


def _array(tensor: Tensor | None) -> Any:
    return None if tensor is None else tensor.detach().cpu().numpy()


def _tensor(array: Any, like: Tensor) -> Tensor:
    return torch.from_numpy(array).to(like.device)
