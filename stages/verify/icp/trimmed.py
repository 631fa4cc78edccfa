"""Trimmed ICP of a model against a cutout of the scene [Bovenkamp 2010, section 2.4].

Upright objects: a pose has four degrees of freedom, the position and the turn about z. All starts
are worked on at once.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F32, F64
from spinpipe.stages.verify.icp.fit import IcpFit, start_poses


def trimmed_icp(
    samples: F64,
    top: F64,
    cutout: F32,
    position: F64,
    *,
    starts: int,
    iterations: int,
    keep: float,
    threads: int = 1,
) -> IcpFit:
    """Register model samples to scene points from evenly spread headings.

    Parameters
    ----------
    samples : (n, 3) points of the model, object frame, metres.
    top : (3,) point of the model at which its spin image was taken, object frame.
    cutout : (N, 3) scene points around the candidate, world; at least one.
    position : (3,) candidate, world.
    starts, iterations : as in the paper 12 and 15.
    keep : share of the pairs, nearest first, that count (variants of ICP, rejecting of pairs:
        [Rusinkiewicz & Levoy 2001, section 3.4]).
    threads : of the neighbour search; the result is the same for any number.
    """
    tree = KDTree(cutout.astype(np.float64))
    kept = max(1, round(keep * len(samples)))
    pose = start_poses(position, top, starts)
    headings = np.degrees(np.arctan2(pose[:, 1, 0], pose[:, 0, 0])) % 360.0
    poses, rms = [pose], []
    for _ in range(iterations):
        rms_m, source, target = _pairs(pose, samples, tree, kept, threads)
        rms.append(rms_m)
        pose = _align(source, target) @ pose
        poses.append(pose)
    rms_m, _, _ = _pairs(pose, samples, tree, kept, threads)
    rms.append(rms_m)
    return IcpFit(np.array(poses), np.array(rms, np.float32), np.full(starts, kept), headings)


def _pairs(pose: F64, samples: F64, tree: KDTree, kept: int, threads: int) -> tuple[F64, F64, F64]:
    """RMS (S,), model points (S, kept, 3) and their nearest scene points, nearest pairs first."""
    moved = np.einsum("sij,nj->sni", pose[:, :3, :3], samples) + pose[:, None, :3, 3]
    distance, row = tree.query(moved, workers=threads)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :kept]
    distance = np.take_along_axis(distance, nearest, axis=1)
    source = np.take_along_axis(moved, nearest[..., None], axis=1)
    target = tree.data[np.take_along_axis(row, nearest, axis=1)]
    return np.sqrt(np.mean(distance**2, axis=1)), source, target


def _align(source: F64, target: F64) -> F64:
    """(S, 4, 4) turns about z with shifts that bring (S, n, 3) sources nearest to targets.

    Least squares in closed form: the angle of the summed horizontal cross and dot products of the
    centred pairs (the planar case of [Horn 1987]).
    """
    from_mean, to_mean = source.mean(axis=1), target.mean(axis=1)
    a = (source - from_mean[:, None])[..., :2]
    b = (target - to_mean[:, None])[..., :2]
    cross = np.sum(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], axis=1)
    dot = np.sum(a * b, axis=(1, 2))
    angle = np.arctan2(cross, dot)
    T = np.tile(np.eye(4), (len(source), 1, 1))
    T[:, 0, 0] = T[:, 1, 1] = np.cos(angle)
    T[:, 1, 0] = np.sin(angle)
    T[:, 0, 1] = -T[:, 1, 0]
    T[:, :3, 3] = to_mean - np.einsum("sij,sj->si", T[:, :3, :3], from_mean)
    return T
