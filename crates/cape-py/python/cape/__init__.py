"""Clothed 3D people on NumPy arrays: SMPL bodies and mesh pyramids."""

from ._cape import CapeError, FileError
from .body import Body, BodyOutput, create, load_smpl
from .pyramid import MeshPyramid

__all__ = [
    "Body",
    "BodyOutput",
    "CapeError",
    "FileError",
    "MeshPyramid",
    "create",
    "load_smpl",
]
