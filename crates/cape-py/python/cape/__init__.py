"""Clothed 3D people on NumPy arrays: SMPL bodies, clothing models, fits, meshes and mesh pyramids.

``cape.torch`` has bodies and models as layers of PyTorch.
"""

from . import data, fit, layer
from ._cape import CapeError, FileError
from .body import Body, BodyOutput, create, load_smpl, poses
from .commands import Command
from .dressed import Dressed
from .mesh import Mesh
from .model import Model
from .pictures import write_png
from .pyramid import MeshPyramid
from .training import Training, train
from .viewer import Viewer

eval = Command("eval")
info = Command("info")

__all__ = [
    "Body",
    "BodyOutput",
    "CapeError",
    "Command",
    "Dressed",
    "FileError",
    "Mesh",
    "MeshPyramid",
    "Model",
    "Training",
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
    "write_png",
]
