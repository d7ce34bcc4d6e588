"""Types of options that several commands have."""

from __future__ import annotations

from typing import Literal

#: Gender of a body.
Gender = Literal["male", "female", "neutral"]
#: Axis of a file of poses that points up; ``auto`` finds it out.
Up = Literal["auto", "y", "z", "-y"]
#: Architectures.
Preset = Literal["paper", "detail", "small", "narrow", "tiny"]
#: Priors of latent codes: standard normal, Gaussian mixture or kernel density of the training codes.
Prior = Literal["normal", "gmm", "kde"]
