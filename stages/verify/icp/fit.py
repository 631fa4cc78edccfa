"""What a registration from several starts gives, and how its best start is chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, F64
from spinpipe.stages.geometry.frames import heading_deg

DISTINCT_HEADING_DEG = 30.0
"""Headings nearer to each other than the starts of the paper are the same answer."""


@dataclass(frozen=True)
class IcpFit:
    """Registrations of one candidate from S starts.

    ``poses`` (iterations, S, 4, 4) T_world_object before each iteration and after the last;
    ``rms_m`` (iterations, S) of the kept pairs at those poses; ``inliers`` (S,) pairs kept at the
    end; ``start_heading_deg`` (S,).
    """

    poses: F64
    rms_m: F32
    inliers: np.ndarray
    start_heading_deg: F64

    @property
    def best(self) -> int:
        """The start with the lowest RMS distance [Bovenkamp 2010, section 2.4]."""
        return int(np.argmin(self.rms_m[-1]))

    @property
    def runner_up(self) -> int | None:
        """The best start that ended at another heading; None if all ended at the same."""
        turned = [heading_deg(T) for T in self.poses[-1]]
        apart = [abs((h - turned[self.best] + 180.0) % 360.0 - 180.0) for h in turned]
        others = np.flatnonzero(np.array(apart) >= DISTINCT_HEADING_DEG)
        return int(others[np.argmin(self.rms_m[-1][others])]) if len(others) else None


def start_poses(position: F64, top: F64, starts: int) -> F64:
    """(S, 4, 4) T_world_object: the model's top at the candidate, headings spread evenly.

    Parameters
    ----------
    position : (3,) candidate, world, metres.
    top : (3,) point of the model at which its spin image was taken, object frame.
    starts : number of headings over the full turn.
    """
    angles = np.arange(starts) * 2.0 * np.pi / starts
    T = np.tile(np.eye(4), (starts, 1, 1))
    T[:, 0, 0] = T[:, 1, 1] = np.cos(angles)
    T[:, 1, 0] = np.sin(angles)
    T[:, 0, 1] = -T[:, 1, 0]
    T[:, :3, 3] = position - np.einsum("sij,j->si", T[:, :3, :3], top)
    return T
