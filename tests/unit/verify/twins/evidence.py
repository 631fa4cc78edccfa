"""Plain twins of what gathers evidence: the surface, the sides, the outline, the scene."""

from __future__ import annotations

import math

import numpy as np
from tests.unit.verify.twins.scene import (
    column,
    depths,
    off_surface,
    side_of,
    to_object,
    to_scene,
    total,
)

from spinpipe.stages.verify.evidence import outline, sides

SIDES = ("front", "left", "back", "right")


def evidence(scene, body, field, pose, limits):
    """All columns of ``EvidenceColumns`` by name."""
    around = outline_evidence(scene, field, pose, limits.gate_m)
    free = np.array([around[side] for side in SIDES]) >= outline.TOUCHED
    claimed, explained, square_sum = claim(body, field, pose, limits.gate_m, free)
    supported, contradicted = side_evidence(scene, field, pose, limits, free)
    return {
        **surface_evidence(scene, field, pose, limits),
        **around,
        "claimed": claimed,
        "explained": explained,
        "rms_m": math.sqrt(square_sum / explained) if explained > 0 else np.inf,
        "side_supported": supported,
        "side_contradicted": contradicted,
    }


def claim(body, field, pose, gate, free):
    """Weights of points claimed and explained, and of squared residuals."""
    u = to_object(pose, body.xyz)
    half, top = field.size[:2] / 2 * pose[4:6], field.size[2] * pose[6]
    out_x, out_y = (np.abs(u[:, :2]) - half).T
    out = np.maximum(out_x, out_y)
    touched = (out > 0) & ~free[side_of(u[:, 0], u[:, 1], out_x, out_y)]
    foot = (u[:, 2] >= 0) & (u[:, 2] < 0.1 * top)
    asked = ~((u[:, 2] > top + gate) | foot | (out > gate) | touched)
    within = (out <= 0) & (u[:, 2] <= top)
    k, offset, normal = off_surface(field, pose, u)
    explained = asked & (k >= 0) & ((offset**2).sum(axis=1) <= gate * gate)
    square = (normal * offset).sum(axis=1) ** 2
    weights = body.weights
    return (
        total(weights[asked & (explained | within)]),
        total(weights[explained]),
        total((weights * square)[explained]),
    )


def surface_evidence(scene, field, pose, limits):
    """Shares of the visible surface."""
    share = dict.fromkeys(("supported", "contradicted", "empty", "sheltered"), 0.0)
    gate, sharp = limits.gate_m, limits.sharp_m
    enough = max(0.25 * scene.density * math.pi * scene.cell_m**2, 1.0)
    places = to_scene(pose, field.probes[:, :2] * pose[4:6])
    levels = pose[2] + field.probes[:, 2] * pose[6]
    for xy, z, normal, weight in zip(
        places, levels, field.probe_normals, field.seen_weight, strict=True
    ):
        if weight <= 0:
            continue
        points = scene.points[column(scene, xy, scene.cell_m)]
        u = to_object(pose, points)
        steep = max(normal[2], 0.3)
        slope = math.sqrt(1 - steep * steep) / steep
        rise = points[:, 2] - z
        at = np.abs(rise) <= gate / steep + 0.5 * slope * scene.cell_m
        above = int((~at & (rise >= 0)).sum())
        inside = depths(field, u[:, :2] / pose[4:6]) > 0.5 * sharp
        below = int((~at & (rise < 0) & inside).sum())
        if above >= enough:
            share["sheltered"] += weight
        held, count = 0.0, int(at.sum())
        if count:
            held = max(min(count / enough, 1.0), count / (count + below))
            mean = signed_distances(field, pose, u[at]).mean()
            if abs(mean) > math.sqrt(sharp**2 + (gate**2 - sharp**2) / count):
                share["contradicted"] += weight
                continue
        share["supported"] += weight * held
        if count + below + above == 0:
            share["empty"] += weight
        elif below and above < enough:
            share["contradicted"] += weight * (1 - held) * min(1.0, below / enough)
    rest = 1 - share["supported"] - share["contradicted"] - share["empty"]
    return share | {"covered": max(0.0, rest)}


def signed_distances(field, pose, u):
    """(N,) distances along the normal of the nearest sample; 0 off the grid."""
    k, offset, normal = off_surface(field, pose, u)
    return np.where(k < 0, 0.0, (normal * offset).sum(axis=1))


def side_evidence(scene, field, pose, limits, free):
    """Shares of the upright surface supported and contradicted."""
    gate, sharp = limits.gate_m, limits.sharp_m
    reach = max(gate, scene.cell_m)
    enough = max(0.25 * scene.density * math.pi * scene.cell_m**2, 1.0)
    places = to_scene(pose, field.sides[:, :2] * pose[4:6])
    levels = pose[2] + field.sides[:, 2] * pose[6]
    supported = contradicted = 0.0
    for xy, z, normal in zip(places, levels, field.side_normals, strict=True):
        points = scene.points[column(scene, xy, reach)]
        dx, dy, dz = (points - [*xy, z]).T
        at = dx * dx + dy * dy + dz * dz <= reach * reach
        beyond = ~at & (dx * dx + dy * dy <= scene.cell_m**2)
        u = to_object(pose, points)
        standing = at & (u[:, 2] > sides.LOW * field.size[2] * pose[6])
        count = int(standing.sum())
        if at.any():
            side = side_of(normal[0], normal[1], abs(normal[0]), abs(normal[1]))
            near = math.sqrt(sharp**2 + (gate**2 - sharp**2) / max(count, 1))
            known = free[side] and count >= sides.STANDING_POINTS
            if known and abs(signed_distances(field, pose, u[standing]).mean()) > near:
                contradicted += 1
            else:
                supported += 1
        elif not (beyond & (dz > 0)).any():
            inside = depths(field, u[beyond][:, :2] / pose[4:6]) > sharp
            contradicted += min(1.0, inside.sum() / enough)
    count = max(len(field.sides), 1)
    return supported / count, contradicted / count


def outline_evidence(scene, field, pose, gate):
    """How far the scene drops outside the outline, and what the object stands on."""
    radius = outline.COLUMN_CELLS * scene.cell_m
    beyond = gate + radius
    apart = beyond + outline.FAR * (field.size[:2] * pose[4:6]).min() / 2
    height, normals = field.size[2] * pose[6], field.outline_normals
    deep = max(gate, outline.DEEP * height)
    tall = field.outline_height > outline.TALL_SHARE * field.size[2]
    foot = field.outline * pose[4:6]
    far, near = to_scene(pose, foot + normals * apart), to_scene(pose, foot + normals * beyond)
    side = side_of(*normals.T, *np.abs(normals).T)
    drop, level, seen = np.zeros((3, len(foot)))
    bases: list[bool] = []
    for k in range(len(foot)):
        found, lowest, _, _ = heights(scene, far[k], radius, pose[2], height)
        if found and lowest <= deep:
            bases.append(lowest >= -deep)
        inner = field.outline_height[k] * pose[6]
        found, lowest, top, overhead = heights(scene, near[k], radius, pose[2], inner + beyond)
        seen[k] = found or overhead <= 2 * inner
        if found:
            drop[k] = np.clip((inner - lowest) / inner, 0, 1)
            goes_on = abs(inner - top) <= max(gate, outline.LEVEL * inner)
            goes_on &= tall[k] and drop[k] < outline.TOUCHED
            level[k] = goes_on and overhead > 2 * inner
    sums = np.array([[v[side == i].sum() for v in (drop, level, seen)] for i in range(4)]).T
    whole = np.maximum(np.bincount(side, minlength=4), 1)
    well = sums[2] >= np.maximum(0.5 * np.bincount(side, minlength=4), 1)
    share = np.where(well, sums[0] / np.maximum(sums[2], 1), 1.0)
    levels = np.where(well, sums[1] / whole, 0.0)
    weight = (sums[2] / whole).sum()
    return {
        "drop": (sums[0] / whole).sum() / weight if weight > 0 else 0.0,
        "ring": seen.mean(),
        "grounded": np.mean(bases) if bases else 1.0,
        **dict(zip(SIDES, share, strict=True)),
        **{f"{name}_level": v for name, v in zip(SIDES, levels, strict=True)},
    }


def heights(scene, xy, radius, base, ceiling):
    """Whether a column shows anything below a ceiling; its quartile, decile, and least above."""
    z = scene.points[column(scene, xy, radius), 2] - base
    low = np.sort(z[z <= ceiling])
    overhead = z[z > ceiling].min(initial=np.inf)
    if len(low) == 0:
        return False, 0.0, 0.0, overhead
    return True, low[3 * len(low) // 4], low[9 * len(low) // 10], overhead
