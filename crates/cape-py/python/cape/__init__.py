"""Clothed 3D people on NumPy arrays: SMPL bodies, clothing models and mesh pyramids."""

from ._cape import CapeError, FileError
from .body import Body, BodyOutput, create, load_smpl
from .model import Dressed, Model
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
]
