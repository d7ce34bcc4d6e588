"""Trained clothing models, in memory and as files.

The functions run commands of the program in a process of their own and return their results, those of
``--json``. ``model`` is a :class:`Model`, the directory of a run or a model file, or None for the built-in
model.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _cape, _program
from ._arrays import BATCH, batches, floats, matrix, points, repeat
from ._program import PathLike, Report
from .body import Body, poses
from .dressed import Dressed
from .viewer import Viewer


class Model:
    """Trained clothing model, of a run of ``cape train``, a model file, or built in."""

    def __init__(self, model: _cape.Model, path: Path | None = None) -> None:
        self._model = model
        #: Directory of the run or model file; None for the built-in model.
        self.path: Path | None = path
        #: Number of latent dimensions.
        self.latent: int = model.latent
        #: Names of the outfits.
        self.outfits: list[str] = model.outfits
        #: Indices of the vertices that clothing covers.
        self.clothing: NDArray[np.int64] = model.clothing
        #: Unclothed body.
        self.body: Body = Body(model.body())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Model:
        """Open the directory of a run or a model file."""
        return cls(_cape.Model.load(Path(path)), Path(path))

    @classmethod
    def pretrained(cls) -> Model:
        """Return the built-in model."""
        return cls(_cape.Model.pretrained())

    def view(
        self,
        motion: str | os.PathLike[str] | None = None,
        port: int = 0,
        proxy: str | None = None,
    ) -> Viewer:
        """Start the interactive viewer, which a notebook shows; ``close()`` of what is returned ends it.

        ``motion`` is a file of a motion to offer beside the synthetic ones; ``port`` 0 is a free one;
        ``proxy``: see :class:`cape.Viewer`.
        """
        return Viewer(self.path, motion=motion, port=port, proxy=proxy)

    def sample(
        self,
        outfit: str,
        n: int = 1,
        pose: ArrayLike | os.PathLike[str] | None = None,
        betas: ArrayLike | None = None,
        seed: int = 1,
        temperature: float = 1.0,
    ) -> Dressed:
        """Dress bodies in ``n`` samples of clothing of an outfit.

        ``pose`` [72] or [n, 72], axis-angle, radians, or a name or file for :func:`cape.poses`;
        ``betas`` [b] or [n, b]; zero if left out. The samples are those of ``cape sample --seed``.
        ``temperature`` is a factor on their deviation from the means of the model's mixture.
        """
        return self.dress(self.codes(outfit, n, seed, temperature), outfit, pose, betas)

    def codes(
        self, outfit: str, n: int = 1, seed: int = 1, temperature: float = 1.0
    ) -> NDArray[np.float32]:
        """Draw latent codes [n, latent] for an outfit."""
        if n < 1 or not 0 <= seed < 2**64:
            raise _cape.CapeError(f"n {n}, seed {seed}: expected n from 1, seed from 0 to 2**64 - 1")
        return self._model.sample(outfit, n, temperature, seed)

    def transport(self, codes: ArrayLike, outfit: str, to: str) -> NDArray[np.float32]:
        """Move ``codes`` [n, latent] of an outfit to their places among the codes of the outfit ``to``.

        A code that is decoded as it is under another outfit keeps traces of its own.
        """
        return self._model.transport(matrix("codes", codes, self.latent), outfit, to)

    def dress(
        self,
        codes: ArrayLike,
        outfit: str | Sequence[str],
        pose: ArrayLike | os.PathLike[str] | None = None,
        betas: ArrayLike | None = None,
        transl: ArrayLike | None = None,
    ) -> Dressed:
        """Dress bodies in the clothing of ``codes`` [n, latent]; ``transl`` [n, 3], metres."""
        given = matrix("codes", codes, self.latent)
        given, angles, outfits = self._wearers("codes", given, pose, outfit)
        displacement = self.decode(given, outfits, angles)
        worn = np.zeros_like(displacement)
        worn[:, self.clothing] = displacement[:, self.clothing]
        posed = self.body(betas, angles[:, 3:], angles[:, :3], transl, worn)
        return Dressed(posed.vertices, worn, given, self.body.faces, tuple(outfits), self)

    def decode(
        self, codes: ArrayLike, outfit: str | Sequence[str], pose: ArrayLike | os.PathLike[str] | None = None
    ) -> NDArray[np.float32]:
        """Decode ``codes`` [n, latent] to displacements [n, V, 3] in the rest pose, metres.

        Only those at the vertices ``clothing`` are worn.
        """
        given = matrix("codes", codes, self.latent)
        given, angles, outfits = self._wearers("codes", given, pose, outfit)
        n = len(given)
        if n <= BATCH:
            return self._model.decode(given, angles, outfits)
        displacement = np.empty((n, self.body.num_vertices, 3), dtype=np.float32)
        for rows in batches(n):
            displacement[rows] = self._model.decode(given[rows], angles[rows], outfits[rows])
        return displacement

    def encode(
        self, displacement: ArrayLike, outfit: str | Sequence[str], pose: ArrayLike | os.PathLike[str] | None = None
    ) -> NDArray[np.float32]:
        """Encode ``displacement`` [n, V, 3], in the rest pose, metres, to codes [n, latent]."""
        worn = points("displacement", displacement, self.body.num_vertices)
        worn, angles, outfits = self._wearers("displacement", worn, pose, outfit)
        codes = np.empty((len(worn), self.latent), dtype=np.float32)
        for rows in batches(len(worn)):
            codes[rows] = self._model.encode(worn[rows], angles[rows], outfits[rows])
        return codes

    def interpolate(self, first: ArrayLike, last: ArrayLike, n: int) -> NDArray[np.float32]:
        """Codes [n, latent] on the line from one code to another, both included."""
        if n < 2:
            raise _cape.CapeError(f"n {n}: expected at least 2")
        ends = [("first", first), ("last", last)]
        a, b = (matrix(name, code, self.latent) for name, code in ends)
        for name, code in (("first", a), ("last", b)):
            if len(code) != 1:
                raise _cape.CapeError(f"{name}: {len(code)} codes, expected 1")
        share = np.linspace(0, 1, n, dtype=np.float32)[:, None]
        return (1 - share) * a + share * b

    def _wearers(
        self,
        name: str,
        values: NDArray[np.float32],
        pose: ArrayLike | os.PathLike[str] | None,
        outfit: str | Sequence[str],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], list[str]]:
        """Values, poses and outfits, as many of each."""
        given = poses(pose) if isinstance(pose, (str, os.PathLike)) else pose
        angles = matrix("pose", given, 3 * self.body.num_joints)
        n = max(len(values), len(angles))
        return repeat(name, values, n), repeat("pose", angles, n), outfit_names(outfit, n)

    def colours(self, displacement: ArrayLike, outfit: str) -> NDArray[np.float32]:
        """Colours of skin, shirt and trousers, sRGB from 0 to 1, [V, 3], of one body's displacement."""
        return self._model.colours(floats("displacement", displacement), outfit)


def outfit_names(outfit: str | Sequence[str], n: int) -> list[str]:
    """Outfit of each of n bodies; one name is that of all."""
    outfits = [outfit] * n if isinstance(outfit, str) else list(outfit)
    if len(outfits) != n:
        raise _cape.CapeError(f"outfits: {len(outfits)} names, expected {n}")
    return outfits


def run_path(model: Model | str | os.PathLike[str] | None) -> Path | None:
    """Path of a model by which commands know it; None for the built-in one."""
    if isinstance(model, Model):
        return model.path
    return None if model is None else Path(model)


def run_paths(name: str, models: Sequence[Model | PathLike]) -> list[Path]:
    """Paths of models; the built-in one has none."""
    paths = [run_path(model) for model in models]
    if None in paths:
        raise _cape.CapeError(f"{name}: the built-in model has no directory, expected a run")
    return [path for path in paths if path is not None]


def import_(
    tf_checkpoint: PathLike,
    out: PathLike,
    *,
    stats: PathLike,
    body: PathLike,
    clothing: PathLike | None = None,
    config: PathLike | None = None,
    factors: Sequence[int] | None = None,
    discriminator_factors: Sequence[int] | None = None,
    threads: int | None = None,
) -> Report:
    """Import the authors' TensorFlow checkpoint as a run ``out``, without TensorFlow.

    ``stats``, ``.npz``, are mean and deviation of the training displacements; ``clothing``, ``.npy``, the
    clothing vertices, from blend weights if left out; ``config`` the release's settings, YAML; ``factors`` those
    of the pyramids.
    """
    return _program.run("model import", locals())


def export(
    model: Model | PathLike | None,
    *,
    onnx: PathLike | None = None,
    half: bool = False,
    npz: PathLike | None = None,
    safetensors: PathLike | None = None,
    threads: int | None = None,
) -> Report:
    """Export a model as graphs in the directory ``onnx``, or its weights as ``npz`` or ``safetensors``.

    The graphs are of decoder, encoder and body, with weights in ``half`` precision if asked; the names in
    ``npz`` are the authors', in ``safetensors`` those of the library. Weights need the directory of a run.
    """
    return _program.run("model export", {**locals(), "model": run_path(model)}, "model")


def pack(
    model: Model | PathLike | None,
    out: PathLike,
    *,
    single: bool = False,
    bytes: bool = False,
    note: Mapping[str, str] | None = None,
    threads: int | None = None,
) -> Report:
    """Pack a run into one file, ``.safetensors``, with weights in half or ``single`` precision, or ``bytes``.

    ``note`` has entries of the file's metadata, such as ``{"licence": "CC BY 4.0"}``.
    """
    given: dict[str, Any] = {**locals(), "model": run_path(model)}
    if note is not None:
        given["note"] = _program.Repeated(f"{name}={text}" for name, text in note.items())
    return _program.run("model pack", given, "model")


def encode(
    model: Model | PathLike | None,
    *registrations: PathLike,
    out: PathLike,
    was: str | None = None,
    minimal: PathLike | None = None,
    decode: bool = False,
    threads: int | None = None,
) -> Report:
    """Encode registrations to latent codes, in ``codes.npy`` of ``out``, empty or missing, a row for each.

    They are frames, or ``frame:K`` for test frames of the run; ``was`` is their outfit, ``minimal`` their body
    [V, 3], ``.npy``, if their places do not tell; ``decode`` also writes the decoded bodies.
    :meth:`Model.encode` encodes arrays.
    """
    given: dict[str, Any] = {**locals(), "model": run_path(model), "registrations": list(registrations)}
    return _program.run("model encode", given, "model", "registrations")


def prior(
    model: Model | PathLike,
    data: PathLike | None = None,
    *,
    kind: Literal["gmm", "kde"] = "gmm",
    components: int | None = None,
    joint: bool = False,
    frames: int = 4096,
    seed: int | None = None,
    threads: int | None = None,
) -> Report:
    """Fit a prior to the codes of the training frames, a mixture or a kernel density for each outfit.

    ``data`` is the packed set, that of the run if left out, of which at most ``frames`` are encoded;
    ``components`` of the mixture, by the Bayesian information criterion if left out; ``joint`` fits one
    density to all outfits.
    """
    return _program.run("model prior", {**locals(), "model": run_path(model)}, "model")


def pyramid(
    mesh: PathLike,
    out: PathLike,
    *,
    factors: Sequence[float] = (2, 2, 2, 2),
    weighting: Literal["barycentric", "release"] = "barycentric",
    threads: int | None = None,
) -> Report:
    """Simplify a mesh level by level and write meshes and SciPy matrices; :class:`cape.MeshPyramid` returns
    them."""
    return _program.run("model pyramid", locals(), "mesh")
