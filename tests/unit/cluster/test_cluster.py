"""The cluster stage: what competes for a peak, and what does not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spinpipe.schemas import CLUSTERS, HITS, MODELS
from spinpipe.schemas.records import Cluster, Hits, ObjectModel
from spinpipe.schemas.topics import Topic
from spinpipe.stages.cluster.cluster import Clustering


class Tables:
    """Just enough of a context: messages in, clusters out."""

    rng = np.random.default_rng(0)

    def __init__(self, models: list[ObjectModel], hits: list[Hits], **config: Any) -> None:
        self.config = Clustering.Config(**config)
        self._inputs: dict[str, list[Any]] = {MODELS.name: models, HITS.name: hits}
        self.clusters: list[Cluster] = []

    def read(self, topic: Topic[Any]) -> list[Any]:
        return self._inputs[topic.name]

    def write(self, topic: Topic[Any], message: Any) -> None:
        assert topic is CLUSTERS
        self.clusters.append(message)

    def log(self, text: str) -> None:
        assert "\n" not in text


def box_model(name: str, size: tuple[float, float, float], stretch: float = 0.0) -> ObjectModel:
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T * size
    empty = np.empty((0, 3), np.float32)
    return ObjectModel(
        name,
        corners.astype(np.float32),
        np.zeros((8, 3), np.float32),
        empty,
        empty.astype(np.int32),
        np.eye(4),
        "all",
        stretch,
    )


def hits(model: str, *rows: tuple[float, float, float, float]) -> Hits:
    table = np.array(rows, np.float32).reshape(-1, 4)
    return Hits(model, table[:, :3], table[:, 3])


def clusters(models: list[ObjectModel], found: list[Hits], **config: Any) -> list[Cluster]:
    tables = Tables(models, found, **config)
    Clustering().run(tables)
    return tables.clusters


def test_rigid_models_of_other_sizes_do_not_take_each_other_s_peaks() -> None:
    models = [box_model("chair", (0.5, 0.5, 0.9)), box_model("bench", (1.6, 0.5, 0.5))]
    found = clusters(models, [hits("chair", (0, 0, 1, 0.6)), hits("bench", (0.1, 0, 0.5, 0.9))])
    assert sorted(c.model for c in found) == ["bench", "chair"]


def test_models_that_may_have_one_size_compete_for_a_peak() -> None:
    models = [box_model("saloon", (4.5, 1.8, 1.45), 0.15), box_model("suv", (4.6, 1.9, 1.7), 0.15)]
    found = clusters(models, [hits("saloon", (0, 0, 1.4, 0.7)), hits("suv", (0.2, 0, 1.5, 0.8))])
    assert [c.model for c in found] == ["suv"]
    assert found[0].hits == 2
    assert found[0].correlation == pytest.approx(0.8)


def test_small_groups_are_left_out_and_numbers_run_on() -> None:
    rows = [(0.0, 0.0, 1.0, 0.7), (0.1, 0.0, 1.0, 0.6), (9.0, 0.0, 1.0, 0.9)]
    models = [box_model("car", (4.0, 2.0, 1.5))]
    found = clusters(models, [hits("car", *rows)], min_hits=2)
    assert [(c.id, c.hits) for c in found] == [(0, 2)]


@pytest.mark.parametrize("method", ["suppression", "delaunay"])
def test_no_hits_are_no_candidates(method: str) -> None:
    assert clusters([box_model("car", (4.0, 2.0, 1.5))], [hits("car")], method=method) == []
