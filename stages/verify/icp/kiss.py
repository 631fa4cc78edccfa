"""Registration by KISS-ICP [Vizzo 2023] as another way to fit a model to a cutout.

Its point-to-point ICP with a robust kernel runs to convergence; the poses are then set upright
and judged by the same residual as trimmed ICP, so that thresholds mean the same.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F32, F64
from spinpipe.stages.geometry.frames import heading_deg, yaw_matrix
from spinpipe.stages.verify.icp.fit import IcpFit, start_poses


def kiss_icp_fit(
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
    """Register as ``trimmed_icp`` does, through ``kiss_icp``.

    Pairs may be as far apart as half the height of the samples, and the kernel is a third of
    that, KISS-ICP's own proportion of the two.
    """
    from kiss_icp.mapping import VoxelHashMap
    from kiss_icp.registration import Registration

    scene = cutout.astype(np.float64)
    tree = KDTree(scene)
    reach_m = float(np.ptp(samples[:, 2])) / 2
    # 20 points a voxel, its own default: ten times as fast as all points, 1 cm less exact.
    voxel_map = VoxelHashMap(voxel_size=reach_m, max_distance=1e9, max_points_per_voxel=20)
    voxel_map.add_points(scene)
    # One thread: the order in which several add up residuals would change the last digits.
    registration = Registration(iterations * 10, 1e-5, max_num_threads=1)
    kept = max(1, round(keep * len(samples)))
    begin = start_poses(position, top, starts)
    end = np.empty_like(begin)
    for i, guess in enumerate(begin):
        T = registration.align_points_to_map(samples, voxel_map, guess, reach_m, reach_m / 3)
        end[i] = _upright(np.asarray(T), top)
    poses = np.stack([begin, end])
    moved = np.einsum("tsij,nj->tsni", poses[..., :3, :3], samples) + poses[..., None, :3, 3]
    distance = np.sort(tree.query(moved, workers=threads)[0], axis=-1)[..., :kept]
    rms_m = np.sqrt(np.mean(distance**2, axis=-1)).astype(np.float32)
    headings = np.array([heading_deg(T) for T in begin])
    return IcpFit(poses, rms_m, np.full(starts, kept), headings)


def _upright(T: F64, top: F64) -> F64:
    """The nearest upright pose that leaves the model's top where it is."""
    turned = yaw_matrix(heading_deg(T), np.zeros(3))
    turned[:3, 3] = T[:3, :3] @ top + T[:3, 3] - turned[:3, :3] @ top
    return turned
