"""Plain, slow twins of verification's kernels: the same formulas over whole arrays, no grid walks.

Sums run from the first point to the last as the kernels' do, so results may be compared closely.
"""

from __future__ import annotations

import math

import numpy as np

from spinpipe.stages.verify.evidence import outline, sides
from spinpipe.stages.verify.fit import coarse_bounds, coarse_search, registration
from spinpipe.stages.verify.judge.kernels import FINE_POINTS
from spinpipe.stages.verify.scene.candidate_points import GROUND_POINTS, TOO_FEW, Points

SIDES = ("front", "left", "back", "right")


def total(values):
    """Sum from the first value to the last."""
    return float(np.add.accumulate(values)[-1]) if len(values) else 0.0


# Frames and look-ups


def to_object(pose, points):
    """(N, 3) points in the object's axes, not unstretched."""
    (dx, dy, dz), c, s = (points - pose[:3]).T, math.cos(pose[3]), math.sin(pose[3])
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, dz])


def to_scene(pose, xy):
    """(N, 2) scene from places in the object's axes, stretched already."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    return np.column_stack(
        [pose[0] + c * xy[:, 0] - s * xy[:, 1], pose[1] + s * xy[:, 0] + c * xy[:, 1]]
    )


def look_up(table, field, u):
    """Values of a table over the field's voxels or columns at points (N, 2 or 3), -1 off it."""
    cell = np.floor((u - field.origin[: u.shape[1]]) * (1.0 / field.voxel_m)).astype(int)
    inside = ((cell >= 0) & (cell < table.shape)).all(axis=1)
    found = np.full(len(u), -1)
    found[inside] = table[tuple(cell[inside].T)]
    return found


def depths(field, u):
    """(N,) how far inside the nearest edge of the outline places (N, 2) lie; -inf off the grid."""
    e = look_up(field.depth_edge, field, u)
    depth = (field.edges[e, 2:] * (field.edges[e, :2] - u)).sum(axis=1)
    return np.where(e < 0, -np.inf, depth)


def off_surface(field, pose, u):
    """Nearest sample of points (N, 3) in the object's axes, offset from it, unit normal there."""
    k = look_up(field.nearest, field, u / pose[4:])
    normal = field.surface[k, 3:6] / pose[4:]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return k, u - pose[4:] * field.surface[k, :3], normal


def column(scene, xy, radius):
    """Rows of the points in a column."""
    dx, dy = scene.points[:, 0] - xy[0], scene.points[:, 1] - xy[1]
    return np.flatnonzero(dx * dx + dy * dy <= radius * radius)


def side_of(x, y, out_x, out_y):
    """Number of the side beyond which a point lies farther."""
    return np.where(out_x >= out_y, np.where(x > 0, 0, 2), np.where(y > 0, 1, 3))


# Points around a candidate


def cut_out(scene, xy, radius, low, ceiling, count):
    """See ``candidate_points.cut_out``."""
    dx, dy = scene.points[:, 0] - xy[0], scene.points[:, 1] - xy[1]
    near = dx * dx + dy * dy < radius * radius
    z = scene.points[:, 2]
    ground = np.flatnonzero(near & (np.abs(z) <= low))
    body = np.flatnonzero(near & (z > low) & (z < ceiling))
    cut = []
    for rows, most in ((body, count), (ground, GROUND_POINTS)):
        stride = max(1, -(-len(rows) // most))
        rows = rows[::stride]
        cut.append(Points(scene.points[rows], scene.weights[rows] * stride))
    return cut


def fine_points(scene, field, limits, start):
    """What a pose is refined with."""
    half_diagonal = math.hypot(field.size[0], field.size[1]) / 2
    reach = half_diagonal * (1 + limits.stretch) + 2 * limits.coarse_gate_m
    ceiling = start[2] + field.size[2] * (1 + 2 * limits.stretch) + 2 * limits.coarse_gate_m
    return cut_out(scene, start[:2], reach, limits.low_m, ceiling, FINE_POINTS)


# Evidence


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
    tall = field.outline_height > outline.TALL * field.size[2]
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


# Registration


def step(body, ground, field, pose, gate, inset, hides, stretch, base):
    """The pose after one Gauss-Newton step, and how far it would move; None if nothing is near."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    scale = pose[4:]
    u = to_object(pose, body.xyz)
    k, offset, n = off_surface(field, pose, u)
    w = 1 - (offset**2).sum(axis=1) / gate**2
    near = (k >= 0) & (w > 0)
    rows = np.column_stack(
        [
            s * n[:, 1] - c * n[:, 0],
            -s * n[:, 0] - c * n[:, 1],
            -n[:, 2],
            n[:, 0] * u[:, 1] - n[:, 1] * u[:, 0],
            -n * field.surface[k, :3],
        ]
    )
    r = (n * offset).sum(axis=1)
    w = body.weights * np.maximum(w, 0) ** 2  # Tukey's biweight
    terms = [(rows[near], r[near], w[near])]
    mass = w[near].sum()
    if mass <= 0:
        return None
    if hides >= 0.5:
        v = to_object(pose, ground.xyz)[:, :2]
        e = look_up(field.depth_edge, field, v / scale[:2])
        m = field.edges[e, 2:] / scale[:2]
        m /= np.linalg.norm(m, axis=1, keepdims=True)
        r = (m * (scale[:2] * field.edges[e, :2] - v)).sum(axis=1) - inset
        held = (e >= 0) & (r > 0) & (r < gate)
        rows = np.zeros((len(v), 7))
        rows[:, 0], rows[:, 1] = c * m[:, 0] - s * m[:, 1], s * m[:, 0] + c * m[:, 1]
        rows[:, 3] = m[:, 1] * v[:, 0] - m[:, 0] * v[:, 1]
        rows[:, 4:6] = m * field.edges[e, :2]
        w = ground.weights * hides * (1 - (r / gate) ** 2) ** 2
        terms.append((rows[held], r[held], w[held]))
    # damping and priors are residuals too, one for each number of the pose
    damp = 1e-4 * mass * np.array([1, 1, 1, field.outermost_m**2, 1, 1, 1])
    level = mass * np.array([0, 0, 0.1 * min(1.0, (gate / base.sd) ** 2) if base.sd > 0 else 0])
    size = 0.02 * mass * (gate / stretch) ** 2 if stretch > 0 else 0.0
    terms.append((np.eye(7), np.zeros(7), damp))
    terms.append((np.eye(7)[:3], pose[:3] - base.z, level))
    terms.append((np.eye(7)[4:], scale - 1, np.full(3, size)))
    rows, r, w = (np.concatenate(parts) for parts in zip(*terms, strict=True))
    dof = 7 if stretch > 0 else 4
    J = rows[:, :dof]
    A, b = (J.T * w) @ J, -(J.T * w) @ r
    delta = np.linalg.solve(A, b)
    moved = max(np.linalg.norm(delta[:3]), abs(delta[3]) * field.outermost_m)
    after = pose.copy()
    after[:dof] += min(1.0, gate / moved) * delta if moved > 0 else 0.0
    if stretch > 0:
        after[4:] = np.clip(after[4:], 1 - stretch, 1 + stretch)
    return after, moved


def hides_ground(ground, field, pose, inset):
    """How much less ground is seen well inside the footprint than around it, 0..1."""
    depth = depths(field, to_object(pose, ground.xyz)[:, :2] / pose[4:6])
    inside, outside = depth > inset, (depth < 0) & (depth > -np.inf)
    areas = (field.depths > inset).sum(), (field.depths < 0).sum()
    seen = total(ground.weights[inside]), total(ground.weights[outside])
    if seen[1] <= 0 or 0 in areas:
        return 0.0
    return max(0.0, 1 - (seen[0] / areas[0]) / (seen[1] / areas[1]))


def follow(body, ground, field, limits, course):
    """Largest distance of each pose (I, 7) of a course from where a step from the last one leads.

    And the number of steps that there should be; from every pose the twin goes on by itself, so
    errors do not add up.
    """
    coarse, fine = limits.coarse_gate_m, limits.gate_m
    base = registration.Base(0.0, fine if limits.stretch > 0 else 0.0)
    off, at = 0.0, 0
    first = registration.FIRST_POINTS
    gates = ((coarse, first), (math.sqrt(coarse * fine), 2 * first), (fine, FINE_POINTS))
    for gate, most in gates:
        stride = max(1, -(-len(body.xyz) // most))
        some = Points(body.xyz[::stride], body.weights[::stride] * stride)
        hides = hides_ground(ground, field, course[at], gate + 0.5 * fine)
        for _ in range(registration.STEPS):
            made = step(
                some, ground, field, course[at], gate, 0.5 * fine, hides, limits.stretch, base
            )
            if made is None or at + 1 == len(course):
                return off, at
            at += 1
            off = max(off, np.abs(made[0] - course[at]).max())
            if made[1] < 1e-3 * gate:
                break
    return off, at


# The coarse search


def search_reach(field, limits):
    """How far from a candidate the points of an object may lie."""
    steps = offset_steps(field, limits)
    half_diagonal = math.hypot(field.size[0], field.size[1]) / 2
    offset = limits.step_m * math.hypot(*steps)
    return half_diagonal * (1 + limits.stretch) + offset + limits.coarse_gate_m


def offset_steps(field, limits):
    """Steps along x and y."""
    narrow = field.size[:2].min() / 2
    long = field.top_half > coarse_bounds.LONG_TOP * narrow
    reach = np.where(long, field.top_half, limits.offset_m)
    return np.ceil(reach / limits.step_m).astype(int)


def coarse_fit(body, ground, field, pose, gate, enough):
    """How purely a pose explains what it claims, 0..1."""
    u = to_object(pose, body.xyz)
    k = look_up(field.nearest, field, u / pose[4:])
    ex, ey, ez = (u - pose[4:] * field.samples[k]).T
    share = 1 - (ex * ex + ey * ey + ez * ez) * (1 / (gate * gate))
    near = k >= 0
    boxed = (np.abs(u[:, :2]) < field.size[:2] / 2 * pose[4:6]).all(axis=1)
    boxed &= (u[:, 2] > 0) & (u[:, 2] < field.size[2] * pose[6])
    explained = total((body.weights * share)[near & (share > 0)])
    over = to_object(pose, ground.xyz)[:, :2] / pose[4:6]
    hidden = look_up(field.footprint, field, over) > 0
    left = np.concatenate([body.weights[near & (share <= 0) & boxed], ground.weights[hidden]])
    if explained <= 0:
        return 0.0
    return explained / (explained + total(left)) * explained / (explained + enough)


def gain_bounds(body, ground, field, limits, base, tall, enough):
    """See ``coarse_bounds.gain_bounds``: (P,) in the order of ``poses_to_try``."""
    f32, voxel, counts = np.float32, field.voxel_m, np.array(field.clearance.shape)
    steps, step = offset_steps(field, limits), limits.step_m / voxel
    first = ((field.top[:2] - field.origin[:2]) / voxel + steps * step).astype(f32)
    level = ((body.xyz[:, 2] - base) / tall - field.origin[2]) / voxel
    level = np.clip(level, 0, counts[2] - 1).astype(int)
    per_m2 = f32((min(1.0, tall) / limits.coarse_gate_m) ** 2)
    bounds = []

    def columns(xyz, yaw, i, j):
        """Places in voxels from the grid's corner, none of them outside."""
        x, y = (xyz[:, :2] / voxel).astype(f32).T
        c, s = f32(math.cos(yaw)), f32(math.sin(yaw))
        shift = np.array([i * step, j * step]).astype(f32)
        turned = np.column_stack([c * x + s * y, c * y - s * x]) + first - shift
        return np.clip(turned, f32(0), (counts[:2] - 1).astype(f32))

    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        for i in range(2 * steps[0] + 1):
            for j in range(2 * steps[1] + 1):
                cell = columns(body.xyz, yaw, i, j).astype(int)
                least = field.clearance[cell[:, 0], cell[:, 1], level]
                share = 1 - np.abs(least) * per_m2
                explained = (body.weights * np.maximum(share, 0)).sum()
                left = body.weights[(share <= 0) & (least < 0)].sum()
                place = columns(ground.xyz, yaw, i, j)
                doubt = np.minimum(place % 1, 1 - place % 1) <= coarse_bounds.DOUBT
                cell = np.where(doubt, 0, place.astype(int))  # surely not below the footprint
                left += ground.weights[field.footprint[cell[:, 0], cell[:, 1]]].sum()
                gain = explained / (explained + left) if explained > 0 else 0.0
                bounds.append(coarse_bounds.SLACK * gain * explained / (explained + enough))
    return np.array(bounds)


def poses_to_try(field, limits, top):
    """Every heading at whole steps around the origin."""
    tall = np.clip(top / field.top_level, 1 - limits.stretch, 1 + limits.stretch)
    base = top - tall * field.top_level if limits.stretch > 0 else 0.0
    tall = tall if limits.stretch > 0 else 1.0
    along, across = (np.arange(-n, n + 1) * limits.step_m for n in offset_steps(field, limits))
    poses = []
    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        cos, sin = math.cos(yaw), math.sin(yaw)
        for dx in along:
            for dy in across:
                ox, oy = dx - field.top[0], dy - field.top[1]
                poses.append([cos * ox - sin * oy, sin * ox + cos * oy, base, yaw, 1.0, 1.0, tall])
    return np.array(poses)


def is_distinct(pose, others, limits):
    """Whether a pose is more than a step or a heading away from all others."""
    turn = np.abs((pose[3] - others[:, 3] + math.pi) % (2 * math.pi) - math.pi)
    shift = np.hypot(pose[0] - others[:, 0], pose[1] - others[:, 1])
    same = (turn < 2.1 * math.pi / limits.headings) & (shift < 2.5 * limits.step_m)
    return not same.any()


def coarse_points(scene, field, limits, top):
    """Points that the coarse search goes by, and the weight that is enough to convince."""
    ceiling = top + field.size[2] * limits.stretch + 2 * limits.coarse_gate_m
    reach = search_reach(field, limits)
    cut = cut_out(scene, (0.0, 0.0), reach, limits.low_m, ceiling, coarse_search.COARSE_POINTS)
    return *cut, 0.1 * field.size[0] * field.size[1] / (scene.cell_m * scene.cell_m)


def coarse_gains(scene, field, limits, top):
    """Poses to try and the gain of each by itself."""
    body, ground, enough = coarse_points(scene, field, limits, top)
    poses = poses_to_try(field, limits, top)
    gains = np.zeros(len(poses))
    if len(body.xyz) >= TOO_FEW:
        gate = limits.coarse_gate_m
        gains[:] = [coarse_fit(body, ground, field, pose, gate, enough) for pose in poses]
    return poses, gains


def coarse_poses(scene, field, limits, top, keep):
    """The best poses of all that are distinct, and their gains."""
    poses, gains = coarse_gains(scene, field, limits, top)
    kept: list[int] = []
    for n in np.argsort(-gains, kind="stable"):
        if gains[n] > 0 and is_distinct(poses[n], poses[kept], limits):
            kept.append(int(n))
        if len(kept) == keep:
            break
    return poses[kept], gains[kept]
