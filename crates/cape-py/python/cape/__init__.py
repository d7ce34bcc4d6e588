"""Clothed 3D people on NumPy arrays: SMPL bodies, clothing models, fits, meshes and mesh pyramids.

Commands of the program are functions of the same names: ``cape eval run`` is ``cape.eval.run``.
``cape.torch`` has bodies and models as layers of PyTorch.
"""

from . import body, data, eval, fit, layer, model, study
from ._cape import CapeError, FileError
from .body import Body, BodyOutput, create, load_smpl, poses
from .commands import animate, demo, export_view, info, redress, sample, vary
from .dressed import Dressed
from .eval import table2
from .mesh import Mesh
from .model import Model
from .pictures import write_png
from .pyramid import MeshPyramid
from .training import Training, check, find_rate, train
from .viewer import Viewer

__all__ = [
    "Body",
    "BodyOutput",
    "CapeError",
    "Dressed",
    "FileError",
    "Mesh",
    "MeshPyramid",
    "Model",
    "Training",
    "Viewer",
    "animate",
    "body",
    "check",
    "create",
    "data",
    "demo",
    "eval",
    "export_view",
    "find_rate",
    "fit",
    "info",
    "layer",
    "load_smpl",
    "model",
    "poses",
    "redress",
    "sample",
    "study",
    "table2",
    "train",
    "vary",
    "write_png",
]
