"""Other libraries' matchers, each as its documentation uses it, in one loop: detect, erase, repeat.

A matcher takes model and scene (voxel-sampled clouds with normals), the voxel's side in metres and
a folder; what it returns takes the mask of scene points not yet erased and proposes poses
T_scene_model, best first.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import KDTree

Array = NDArray[Any]
Propose = Callable[[Array], Iterable[Array]]

VOXELS_ACROSS = 8
"""The voxel's side is this part of the shortest side of the model's box: one rule for all."""
TOLERANCE_VOXELS = 1.5
"""How near a scene point must be to a model point: Open3D's tutorial of global registration."""
MIN_FITNESS = 0.7
"""Least share of the model's points with a scene point in reach; no library names one."""
PATIENCE = 3
"""Rounds without an acceptance in a row after which a matcher that draws at random stops."""
OPENCV_POSES = 20
"""Best poses of a round that are refined; OpenCV's sample takes 2, of scenes with one object."""
KISS_INLIERS = 5
"""Fewer final inliers are a failure, says KISS-Matcher's example."""


def read_points(path: Path) -> Array:
    """Float64 points (n, 3); of a mesh samples a quarter voxel apart, its underside left out."""
    if path.suffix == ".laz":
        return np.asarray(laspy.read(path).xyz, float)
    thing: Any = trimesh.load(path)
    faces = getattr(thing, "faces", ())
    if len(faces) == 0:
        return np.asarray(thing.vertices, float)
    spacing_m = float(np.ptp(thing.vertices, axis=0).min()) / VOXELS_ACROSS / 4
    thing.update_faces(thing.face_normals[:, 2] > -0.5)
    count = int(thing.area / spacing_m**2)
    return np.asarray(trimesh.sample.sample_surface(thing, count, seed=0)[0])


def search(name: str, model_file: Path, scene_file: Path, out: Path) -> None:
    """Find instances and write them to out after each, as the run of spinpipe would."""
    o3d = import_module("open3d")
    o3d.utility.random.seed(0)
    model_points, scene_points = read_points(model_file), read_points(scene_file)
    low, high = model_points.min(axis=0), model_points.max(axis=0)
    voxel, offset = float((high - low).min()) / VOXELS_ACROSS, scene_points.mean(axis=0)
    model, scene = (_sampled(points, voxel) for points in (model_points, scene_points - offset))
    base = np.array([*(low + high)[:2] / 2, low[2], 1.0])
    propose = MATCHERS[name](model, scene, voxel, out)
    xyz, reach = np.asarray(scene.points), TOLERANCE_VOXELS * voxel
    left, detections, misses = np.ones(len(xyz), bool), [], 0
    while misses < (PATIENCE if name in RANDOM else 1) and left.sum() > len(model.points):
        misses += 1
        placed = [(np.asarray(model.points) @ T[:3, :3].T + T[:3, 3], T) for T in propose(left)]
        placed.sort(key=lambda own: -_reached(own[0], xyz[left], reach).mean())
        for points, T in placed:
            fitness = float(_reached(points, xyz[left], reach).mean())
            if fitness < MIN_FITNESS:
                continue
            left &= ~_reached(xyz, points, reach)
            misses = 0
            T_scene_model = T.copy()
            T_scene_model[:3, 3] += offset
            detections.append({
                "fate": "accepted", "score": fitness, "T_scene_model": T_scene_model.tolist(),
                "position_scene": (T_scene_model @ base)[:3].tolist(),
            })  # fmt: skip
            partial = out / "detections.partial"
            partial.write_text(json.dumps({"detections": detections}))
            partial.rename(out / "detections.json")


def _sampled(points: Array, voxel: float) -> Any:
    """One point a voxel, with normals that face up, as the cameras saw them."""
    o3d = import_module("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * voxel, 30))
    cloud.orient_normals_to_align_with_direction(np.array([0.0, 0.0, 1.0]))
    return cloud


def _reached(points: Array, others: Array, reach: float) -> Array:
    """Whether one of the others lies within reach, of each point."""
    return np.isfinite(KDTree(others).query(points, distance_upper_bound=reach)[0])


def _left(cloud: Any, left: Array) -> Any:
    return cloud.select_by_index(np.flatnonzero(left))


def _rows(cloud: Any) -> Array:
    """Float32 (n, 6): points and normals."""
    return np.hstack([np.asarray(cloud.points), np.asarray(cloud.normals)]).astype(np.float32)


def _refined(model: Any, scene: Any, voxel: float, T: Array) -> Array:
    reg = import_module("open3d").pipelines.registration
    plane = reg.TransformationEstimationPointToPlane()
    return np.array(reg.registration_icp(model, scene, voxel, T, plane).transformation)


def match_open3d(model: Any, scene: Any, voxel: float, folder: Path) -> Propose:
    """FPFH, RANSAC on feature matches, point-to-plane ICP: the tutorial of global registration."""
    o3d = import_module("open3d")
    reg = o3d.pipelines.registration
    around = o3d.geometry.KDTreeSearchParamHybrid(5 * voxel, 100)
    model_features, features = (reg.compute_fpfh_feature(c, around) for c in (model, scene))

    def propose(left: Array) -> Iterable[Array]:
        own, target = reg.Feature(), _left(scene, left)
        own.data = np.asarray(features.data)[:, left]
        reach = TOLERANCE_VOXELS * voxel
        checks = [
            reg.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            reg.CorrespondenceCheckerBasedOnDistance(reach),
        ]
        found = reg.registration_ransac_based_on_feature_matching(
            model, target, model_features, own, True, reach,
            reg.TransformationEstimationPointToPoint(False), 3, checks,
            reg.RANSACConvergenceCriteria(100000, 0.999),
        )  # fmt: skip
        yield _refined(model, target, voxel, found.transformation)

    return propose


def match_opencv(model: Any, scene: Any, voxel: float, folder: Path) -> Propose:
    """Point pair features [Drost 2010] and OpenCV's ICP: the sample ppf_load_match.py."""
    cv2 = import_module("cv2")
    step = voxel / float(np.linalg.norm(model.get_max_bound() - model.get_min_bound()))
    detector = cv2.ppf_match_3d_PPF3DDetector(step, step)
    detector.trainModel(_rows(model))

    def propose(left: Array) -> Iterable[Array]:
        target = _left(scene, left)
        step = voxel / float(np.ptp(np.asarray(target.points), axis=0).max())
        poses = detector.match(_rows(target), 1 / 40, step)[:OPENCV_POSES]
        icp = cv2.ppf_match_3d_ICP(100)
        _, poses = icp.registerModelToScene(_rows(model), _rows(target), poses)
        return [np.array(pose.pose) for pose in poses]

    return propose


def match_kiss(model: Any, scene: Any, voxel: float, folder: Path) -> Propose:
    """KISS-Matcher [Lim 2025], refined by Open3D's ICP."""
    kiss = import_module("kiss_matcher")

    def propose(left: Array) -> Iterable[Array]:
        target = _left(scene, left)
        matcher = kiss.KISSMatcher(kiss.KISSMatcherConfig(voxel))
        found = matcher.estimate(*(np.asarray(c.points, np.float32) for c in (model, target)))
        if found.valid and matcher.get_num_final_inliers() >= KISS_INLIERS:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation)
            yield _refined(model, target, voxel, T)

    return propose


def match_pcl(model: Any, scene: Any, voxel: float, folder: Path) -> Propose:
    """Spin images, prerejective RANSAC and ICP of PCL: ``pcl_match.cpp``."""
    files = folder / "model.f32", folder / "scene.f32"
    for file, cloud in zip(files, (model, scene), strict=True):
        _rows(cloud).tofile(file)
    command = [folder.parent / "pcl_match", *files, str(voxel)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin
    assert process.stdout
    sent, got = process.stdin, process.stdout

    def propose(left: Array) -> Iterable[Array]:
        sent.write(left.tobytes())
        sent.flush()
        T = np.frombuffer(got.read(64), np.float32).reshape(4, 4).astype(float)
        return [T] if np.isfinite(T).all() else []

    return propose


MATCHERS = {"opencv": match_opencv, "open3d": match_open3d, "pcl": match_pcl, "kiss": match_kiss}
RANDOM = ("open3d", "pcl")
