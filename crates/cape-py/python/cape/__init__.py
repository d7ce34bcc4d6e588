"""Clothed 3D people on NumPy arrays: SMPL bodies, clothing models and mesh pyramids.

``cape.torch`` has both as layers of PyTorch.
"""

from ._cape import CapeError, FileError
from .body import Body, BodyOutput, create, load_smpl, poses
from .dressed import Dressed
from .model import Model
from .pyramid import MeshPyramid

__all__ = [
    "Body",
    "BodyOutput",
    "CapeError",
    "Dressed",
    "FileError",
    "MeshPyramid",
    "Model",
    "create",
    "load_smpl",
    "poses",
]
