"""What fits of a model are judged by: lengths that follow from model, density, noise and error."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spinpipe.schemas.records import Sampling
from spinpipe.stages.verify.model.field import ModelField

GREATEST_ERROR = 0.12
"""Error of a reconstructed shape, at most, as a share of half the narrow side: chosen. A car of
half width 0.85 m may be off by 0.10 m; the paper accepts 0.115 m [Bovenkamp 2010, section 3.2]."""


class Tolerance(NamedTuple):
    """What a fit of one model is judged by; all follow from model, density, noise and error.

    Attributes
    ----------
    gate_m : a point farther than this from the model's surface is not explained by it.
    sharp_m : the same without noise: how far the surface itself may be off.
    coarse_gate_m : the same during the coarse search, at least its step.
    step_m : offset between the starts of the coarse search.
    chance : share of the visible surface that a surface at a random height seems to support.
    headings : number of headings of the coarse search.
    offset_m : how far a candidate may lie from the middle of the model's top.
    low_m : what is lower than this above the ground may be the ground.
    stretch : largest relative change of each extent.
    """

    gate_m: float
    sharp_m: float
    coarse_gate_m: float
    step_m: float
    chance: float
    headings: int
    offset_m: float
    low_m: float
    stretch: float


def greatest_error_m(model: ModelField) -> float:
    """How far the surface of an instance may be off at the size of the object, metres."""
    return GREATEST_ERROR * model.narrow_m


def tolerance(model: ModelField, stretch: float, sampling: Sampling, error_m: float) -> Tolerance:
    """Tolerances of a model in a cloud.

    The gate is three standard deviations of the noise of points and of the error of surfaces, the
    spacing of the points and how badly the shape itself is known, in quadrature: a model that may
    stretch by a share of its size is known to that share of its narrow half extent.

    Parameters
    ----------
    model : the model.
    stretch : largest relative change of each extent.
    sampling : of the cloud.
    error_m : standard deviation of a reconstructed surface at the size of the object.
    """
    narrow, noise_m = model.narrow_m, sampling.noise_m
    shape = stretch * narrow
    sharp = math.hypot(sampling.spacing_m, shape, 2 * error_m)
    gate = math.hypot(sampling.spacing_m, shape, 3 * noise_m, 3 * error_m)
    step = 0.3 * narrow
    # the mean of the points in a column, two spacings around a probe
    column = math.hypot(sharp, 3 * noise_m / math.sqrt(4 * math.pi))
    half_length = max(model.size[0], model.size[1]) / 2
    return Tolerance(
        gate_m=gate,
        sharp_m=sharp,
        coarse_gate_m=max(gate, step),
        step_m=step,
        chance=min(0.5, 2 * column / model.size[2]),
        headings=max(16, math.ceil(2 * math.pi * half_length / (3 * step))),
        offset_m=0.9 * narrow,
        low_m=max(3 * noise_m, 0.07 * model.size[2]),
        stretch=float(stretch),
    )


def shell_share(model: ModelField, gate_m: float) -> float:
    """Share of the volume a model claims that lies within ``gate_m`` of its surface.

    It is what points scattered at random over the claimed volume would seem to explain.
    """
    shape = model.nearest.shape
    axes = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    centres = model.origin + (np.stack(axes, -1) + 0.5) * model.voxel_m
    near = model.distances(centres.reshape(-1, 3)).reshape(shape) < gate_m
    high = centres[..., 2] > 0.1 * model.size[2]
    box = (np.abs(centres[..., :2]) < model.size[:2] / 2).all(axis=-1)
    box &= centres[..., 2] < model.size[2]
    return float((near & high).sum() / ((near | box) & high).sum())
