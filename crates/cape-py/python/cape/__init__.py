"""Clothed 3D people on NumPy arrays: SMPL bodies, clothing models and mesh pyramids.

``cape.torch`` has both as layers of PyTorch.
"""

from ._cape import CapeError, FileError
from .body import Body, BodyOutput, create, load_smpl, poses
from .commands import Command, Viewer
from .dressed import Dressed
from .model import Model
from .pyramid import MeshPyramid

data = Command("data")
eval = Command("eval")
fit = Command("fit")
info = Command("info")
layer = Command("layer")
train = Command("train")

__all__ = [
    "Body",
    "BodyOutput",
    "CapeError",
    "Command",
    "Dressed",
    "FileError",
    "MeshPyramid",
    "Model",
    "Viewer",
    "create",
    "data",
    "eval",
    "fit",
    "info",
    "layer",
    "load_smpl",
    "poses",
    "train",
]
