"""The experiments of [Bovenkamp 2010, section 3], run with the stages themselves."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.commands import execute
from spinpipe.pipeline.config import load_config
from spinpipe.pipeline.context import RunReader, thread_count
from spinpipe.pipeline.demo import write_scene
from spinpipe.pipeline.evaluation.evaluation import distances, nearest_pairs
from spinpipe.pipeline.evaluation.truth import TruthObject, read_truth
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.scenes.artificial import SEED, ArtificialScene, make_scene
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas import CLOUD, CLUSTERS, DETECTIONS, HITS, MODELS, SCENE, TILES, UPRIGHT
from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.model_surface import topmost_point
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.verify.icp.trimmed import trimmed_icp

BINS_M = (0.1, 0.2)
NOISE_M = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4)
SAMPLES = (100, 500, 1000, 2000)
ARTIFICIAL_BIN_M = 0.2
"""Of section 3.4 on the artificial scene: proposes right ones and wrong ones."""
RADIUS_M, HEIGHT_M = 2.5, 1.0
MATCH_M = 1.5
"""Farthest candidate from a car's base centre that counts as found."""
MAX_CANDIDATES = 80
"""Of section 3.4: the best correlated ones."""
STARTS, ITERATIONS, KEEP = 12, 15, 0.8

Models = Sequence[tuple[str, Path, str]]
"""Name, file, ``visible_from``."""


@dataclass(frozen=True)
class Found:
    """What one setting finds in a scene of cars of two models."""

    of_model_1: int
    of_model_2: int
    false: int
    """On no car."""
    hits: int
    right_type: int = 0
    """Found cars that got the name of their model."""


@dataclass(frozen=True)
class Residuals:
    """Residuals of one number of model samples, section 3.4."""

    samples: int
    right_m: F64
    """RMS distances of the candidates on a car, ascending."""
    wrong_m: F64
    """Of the others."""
    seconds: float

    @property
    def separation(self) -> float:
        """How often a right candidate has a smaller residual than a wrong one."""
        return float(np.mean(self.right_m[:, None] < self.wrong_m[None]))


def paper_settings(bin_m: float) -> list[str]:
    """Overrides that give the paper's scan and clustering."""
    return [
        f"scan.radius_m={RADIUS_M}",
        f"scan.height_m={HEIGHT_M}",
        f"scan.bin_m={bin_m}",
        "scan.min_correlation=0.6",
        "scan.heights=any",
        "scan.origins=all",
        "scan.model_origin=topmost",
        "scan.lift_m=0",
        "scan.noise_m=0",
        "cluster.method=delaunay",
        f"cluster.max_edge_m={RADIUS_M}",
        "cluster.min_hits=3",
    ]


class ArtificialExperiment:
    """The artificial scene in a folder, in which several settings are tried."""

    def __init__(self, folder: Path, scene: ArtificialScene) -> None:
        self.folder = folder
        self.scene = scene
        write_scene(folder, scene)

    @property
    def read(self) -> RunReader:
        """Reads the topics of the last run."""
        return RunReader(RunFolder(self.folder / "run"))

    def models(self, *names: str) -> Models:
        """Clouds of the models, sampled from their whole surface."""
        return [(name, self.folder / f"{name}.ply", "all") for name in names]

    def models_from_above(self, *names: str) -> Models:
        """Meshes of the models, of which the part that a sensor above sees is sampled."""
        for name in names:
            rows = cloud_rows(self.scene.models[name].vertices)
            faces = self.scene.models[name].faces.astype(np.int32)
            path = self.folder / f"{name}_mesh.ply"
            write_atomically(path, partial(write_ply, vertices=rows, faces=faces))
        return [(name, self.folder / f"{name}_mesh.ply", "above") for name in names]

    def candidates(self, models: Models, bin_m: float) -> Found:
        """What the paper's scan and clustering propose."""
        read = self._run(models, paper_settings(bin_m), until="cluster")
        places = np.array([c.position for c in read(CLUSTERS)]).reshape(-1, 3)
        names = [c.model for c in read(CLUSTERS)]
        places[:, 2] = 0.0  # a candidate is where the top may be, a label where the base is
        return self._count(read, places, names)

    def detections(self, models: Models) -> Found:
        """What the whole pipeline accepts with its defaults."""
        read = self._run(models, [], until=None)
        accepted = [d for d in read(DETECTIONS) if d.fate == "accepted"]
        places = np.array([d.position_world for d in accepted]).reshape(-1, 3)
        return self._count(read, places, [d.model for d in accepted])

    def _run(self, models: Models, overrides: list[str], until: str | None) -> RunReader:
        overrides = ["ground.up=[0, 0, 1]", *overrides]  # known, as in the paper
        return run_scene(self.folder, self.folder / "scene.ply", models, overrides, until)

    def _count(self, read: RunReader, places: F64, names: list[str]) -> Found:
        cars = labels_of(read, self.folder / "truth.csv")
        far = distances(cars, places)
        pairs = nearest_pairs(np.where(far <= MATCH_M, far, np.inf))
        found = [cars[car].model for car, _ in pairs]
        return Found(
            of_model_1=found.count("model_1"),
            of_model_2=found.count("model_2"),
            false=len(names) - len(pairs),
            hits=sum(len(h.points) for h in read(HITS)),
            right_type=sum(cars[car].model == names[i] for car, i in pairs),
        )


def noise_scene(noise_m: float) -> ArtificialScene:
    """The scene of section 3.3: the same layout and samples at every noise."""
    return make_scene(noise_m=noise_m, rng=np.random.default_rng(SEED))


def seen_from_above_scene() -> ArtificialScene:
    """The scene of section 3.2."""
    return make_scene(rng=np.random.default_rng(SEED), seen_from="above")


def run_scene(
    folder: Path, scene: Path, models: Models, overrides: list[str], until: str | None
) -> RunReader:
    """Run a scene quietly in ``folder``/run and give a reader of its topics."""
    lines = [f"[ingest]\nscene = '{scene.resolve()}'"]
    lines += [
        f"[[model]]\nname = '{name}'\npath = '{path.resolve()}'\nvisible_from = '{visible}'"
        for name, path, visible in models
    ]
    config = folder / "config.toml"
    text = "\n".join(lines) + "\n"
    write_atomically(config, lambda file: file.write_text(text, encoding="utf-8"))
    run = RunFolder(folder / "run")
    execute(load_config(config, overrides), run, None, until, "off", quiet=True)
    return RunReader(run)


def residuals(
    read: RunReader, truth: Sequence[TruthObject], counts: Sequence[int], seed: int = 0
) -> Iterator[Residuals]:
    """Register every candidate of a run as in section 2.4, with different numbers of samples.

    Candidates whose registration ends on an object to be ignored count neither way.
    """
    models = {m.name: m for m in read(MODELS)}
    cloud = WorldCloud.of(read(CLOUD), read(TILES)[0], read(UPRIGHT)[0])
    chosen = sorted(read(CLUSTERS), key=lambda c: (-c.correlation, c.id))[:MAX_CANDIDATES]
    reach = np.array([RADIUS_M, RADIUS_M, 0.0])
    for count in counts:
        rng = np.random.default_rng(seed)
        began = time.perf_counter()
        rms: list[float] = []
        ends: list[F64] = []
        for cluster in chosen:
            points = models[cluster.model].points.astype(np.float64)
            upper = points[points[:, 2] > points[:, 2].max() - HEIGHT_M]
            samples = upper[rng.choice(len(upper), min(count, len(upper)), replace=False)]
            position = np.array(cluster.position)
            box = cloud.inside(position - reach - [0.0, 0.0, HEIGHT_M], position + reach)
            near = np.linalg.norm(box[:, :2] - position[:2], axis=1) < RADIUS_M
            fit = trimmed_icp(
                samples,
                topmost_point(models[cluster.model].points),
                box[near],
                position,
                starts=STARTS,
                iterations=ITERATIONS,
                keep=KEEP,
                threads=thread_count(0),
            )
            rms.append(float(fit.rms_m[-1, fit.best]))
            ends.append(fit.poses[-1, fit.best, :3, 3])
        seconds = time.perf_counter() - began
        right, wrong = _sorted_out(np.array(rms), np.array(ends), truth)
        yield Residuals(count, right, wrong, seconds)


def _sorted_out(rms: F64, ends: F64, truth: Sequence[TruthObject]) -> tuple[F64, F64]:
    """Ascending residuals of the candidates that ended on an object, and of the others."""
    near = distances(truth, ends) <= MATCH_M
    ignored = np.array([t.ignore for t in truth], bool)
    on_object = np.any(near[~ignored], axis=0)
    off = ~on_object & ~np.any(near[ignored], axis=0)
    return np.sort(rms[on_object]), np.sort(rms[off])


def labels_of(read: RunReader, path: Path) -> list[TruthObject]:
    """Labels of a run's scene, brought to its world frame."""
    return read_truth(path, read(SCENE)[0], read(UPRIGHT)[0], "scene")
