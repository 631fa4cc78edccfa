"""Records survive the way through their protobuf messages, byte for byte."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from spinpipe.schemas import (
    CLUSTERS,
    DETECTIONS,
    HITS,
    HYPOTHESES,
    MODELS,
    PLANE,
    SCENE,
    SPIN_IMAGES,
    TILES,
    TRACES,
    records,
)
from spinpipe.schemas.topics import Topic, topic_named

numbers = st.floats(allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers)
texts = st.text(max_size=20)
counts = st.integers(0, 2**32 - 1)


def floats(width: int, *shape: int | None) -> st.SearchStrategy[Any]:
    """Arrays of float32 or float64; a dimension of ``None`` may have any length, also 0."""
    sizes = st.tuples(*(st.integers(0, 5) if n is None else st.just(n) for n in shape))
    return hnp.arrays(np.dtype(f"f{width // 8}"), sizes, elements=st.floats(width=width))


RECORDS: list[tuple[Topic[Any], st.SearchStrategy[Any]]] = [
    (
        SCENE,
        st.builds(
            records.SceneFrame,
            vectors,
            vectors,
            st.integers(0, 2**64 - 1),
            counts,
            st.booleans(),
            texts,
        ),
    ),
    (
        TILES,
        st.builds(
            records.TileIndex,
            floats(32, None, 3),
            floats(32, None, 3),
            hnp.arrays(np.int64, st.integers(0, 5)),
        ),
    ),
    (
        MODELS,
        st.builds(
            records.ObjectModel,
            texts,
            floats(32, None, 3),
            floats(32, None, 3),
            floats(32, None, 3),
            hnp.arrays(np.int32, st.tuples(st.integers(0, 5), st.just(3))),
            floats(64, 4, 4),
            texts,
            numbers,
        ),
    ),
    (
        PLANE,
        st.builds(
            records.Plane,
            vectors,
            numbers,
            counts,
            counts,
            numbers,
            numbers,
            texts,
            st.lists(st.builds(records.Evidence, texts, numbers), max_size=3).map(tuple),
        ),
    ),
    (
        SPIN_IMAGES,
        st.builds(
            records.SpinImage,
            texts,
            texts,
            numbers,
            numbers,
            numbers,
            floats(32, None, None),
            vectors,
            numbers,
        ),
    ),
    (HITS, st.builds(records.Hits, texts, floats(32, None, 3), floats(32, None))),
    (CLUSTERS, st.builds(records.Cluster, counts, texts, vectors, counts, numbers, texts)),
    (
        HYPOTHESES,
        st.builds(
            records.BlockHypotheses,
            counts,
            *(floats(64, None).map(lambda a: a.astype(np.int64)),) * 2,
            *(floats(64, None, 7), floats(64, None, 7), floats(64, None, 2)),
            *(floats(64, None, None), floats(64, None, None), floats(64, None)),
            *(floats(64, None).map(lambda a: a.astype(np.int64)),) * 2,
            *(floats(64, None, 7), floats(64, None)),
        ),
    ),
    (
        TRACES,
        st.builds(
            records.FitTrace,
            counts,
            floats(64, None),
            floats(32, None, None),
            floats(64, None, 4, 4),
        ),
    ),
    (
        DETECTIONS,
        st.builds(
            records.Detection,
            id=counts,
            inlier_weight=numbers,
            model=texts,
            fate=st.sampled_from(["accepted", "ambiguous", "rejected"]),
            reason=texts,
            T_world_object=floats(64, 4, 4),
            T_scene_model=floats(64, 4, 4),
            position_world=vectors,
            position_scene=vectors,
            heading_margin=st.floats(),
            rms_m=st.floats(),
            parts=st.lists(st.builds(records.Part, texts, numbers), max_size=3).map(tuple),
            size_m=vectors,
            alternative=texts,
        ),
    ),
]


@pytest.mark.parametrize(("topic", "record"), RECORDS, ids=lambda v: getattr(v, "name", ""))
@given(data=st.data())
def test_a_record_comes_back_as_it_was(
    topic: Topic[Any], record: st.SearchStrategy[Any], data: st.DataObject
) -> None:
    before = data.draw(record)
    after = topic.decode(topic.encode(before).SerializeToString())
    assert type(after) is type(before)
    for field in dataclasses.fields(before):
        expected, got = getattr(before, field.name), getattr(after, field.name)
        if isinstance(expected, np.ndarray):
            assert got.dtype == expected.dtype
            np.testing.assert_array_equal(got, expected, strict=True)
        else:
            np.testing.assert_equal(got, expected)


def test_arrays_of_any_layout_travel_in_c_order_and_little_endian() -> None:
    values = np.arange(12, dtype=">f4").reshape(3, 4).T
    image = records.SpinImage("m", "model", 1, 1, 1, values, (0, 0, 0), 1)
    message = SPIN_IMAGES.encode(image)
    assert message.values.dtype == "<f4"  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_array_equal(
        SPIN_IMAGES.decode(message.SerializeToString()).values, values.astype("<f4")
    )


def test_a_topic_is_pickled_by_name() -> None:
    assert pickle.loads(pickle.dumps(HITS)) is HITS
    assert topic_named("/scan/hits") is HITS
    with pytest.raises(KeyError):
        topic_named("/scan/nothing")
