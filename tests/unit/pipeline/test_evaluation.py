"""Matches, scores and the precision-recall curve."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.pipeline.evaluation.evaluation import (
    choose_rule,
    percentiles,
    precision_recall,
    score_detections,
)
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.schemas.records import Detection


def truth(x, y=0.0, *, model="car", z=np.nan, heading=None, axis=None, ignore=False):
    axis = heading if axis is None else axis
    return TruthObject(
        2, (x, y), model, (x, y, z), heading, None if axis is None else axis % 180, ignore
    )


def detection(x, y=0.0, *, number=0, model="car", z=0.0, heading=0.0, score=0.9, **more):
    pose = np.eye(4)
    return Detection(
        id=number,
        model=model,
        fate=more.get("fate", "accepted"),
        reason=more.get("reason", ""),
        T_world_object=pose,
        T_scene_model=pose,
        position_world=(x, y, z),
        position_scene=(x, y, z),
        heading_deg=heading,
        heading_margin=0.0,
        correlation=0.9,
        rms_m=0.05,
        inlier_weight=100.0,
        runner_up_heading_deg=0.0,
        runner_up_rms_m=0.1,
        coverage_model=1.0,
        coverage_scene=1.0,
        observed=1.0,
        score=score,
        size_m=(4.0, 2.0, 1.5),
    )


def score(truths, detections, radius_m=1.5, rule="any"):
    return score_detections(truths, detections, range(len(detections)), radius_m, rule)


def test_as_many_matches_as_possible_before_the_nearest():
    # The first detection is nearest to the second truth, but only it reaches the first one
    result = score([truth(0.0), truth(2.0)], [detection(1.4), detection(3.4)])
    assert [(m.truth, m.detection) for m in result.matches] == [(0, 0), (1, 1)]
    assert result.recall == result.precision == result.f1 == 1.0


@given(
    st.lists(st.tuples(st.floats(0, 4), st.floats(0, 4)), max_size=4),
    st.lists(st.tuples(st.floats(0, 4), st.floats(0, 4)), max_size=4),
)
def test_matching_is_the_best_of_all(places, found):
    truths, detections = [truth(*p) for p in places], [detection(*p) for p in found]
    result = score(truths, detections)

    def value(pairs):
        near = [np.hypot(places[t][0] - found[d][0], places[t][1] - found[d][1]) for t, d in pairs]
        return (-len(pairs), sum(near)) if all(n <= 1.5 for n in near) else (1, 0.0)

    best = min(
        value(list(zip(ts, ds, strict=True)))
        for size in range(min(len(places), len(found)) + 1)
        for ts in itertools.combinations(range(len(places)), size)
        for ds in itertools.permutations(range(len(found)), size)
    )
    assert len(result.matches) == -best[0]
    assert sum(m.distance_m for m in result.matches) == pytest.approx(best[1], abs=1e-9)
    assert len(result.missed) == len(places) - len(result.matches)
    assert len(result.false) == len(found) - len(result.matches)


def test_ignored_objects_count_neither_way():
    truths = [truth(0.0), truth(10.0, ignore=True), truth(20.0, ignore=True)]
    result = score(truths, [detection(0.1), detection(10.2), detection(9.9), detection(30.0)])
    assert [m.truth for m in result.matches] == [0]
    assert result.missed == ()
    assert result.neither == (1, 2)
    assert result.false == (3,)


def test_model_counts_only_by_name():
    truths, detections = [truth(0.0, model="van")], [detection(0.0, model="saloon")]
    assert score(truths, detections).recall == 1.0
    by_name = score(truths, detections, rule="name")
    assert by_name.recall == 0.0
    assert by_name.false == (0,)
    assert choose_rule(truths, ["saloon"]) == "any"
    assert choose_rule(truths, ["saloon", "van"]) == "name"


def test_height_counts_where_it_is_known():
    assert score([truth(0.0, z=0.0)], [detection(0.0, z=3.0)]).recall == 0.0
    (match,) = score([truth(0.0, z=0.0)], [detection(0.3, z=0.4)]).matches
    assert match.distance_m == pytest.approx(0.3)
    assert match.height_error_m == pytest.approx(0.4)
    assert score([truth(0.0)], [detection(0.0, z=3.0)]).matches[0].height_error_m is None


@pytest.mark.parametrize(
    ("labelled", "found", "error", "flipped"),
    [(350, 10, 20, False), (10, 350, -20, False), (0, 180, 180, True), (90, 265, 175, True)],
)
def test_heading_error(labelled, found, error, flipped):
    (match,) = score([truth(0.0, heading=labelled)], [detection(0.0, heading=found)]).matches
    assert match.heading_error_deg == pytest.approx(error)
    assert match.flipped is flipped
    assert match.axis_error_deg == pytest.approx(min(abs(error), 180 - abs(error)))


def test_axis_error_has_no_front():
    (match,) = score([truth(0.0, axis=175)], [detection(0.0, heading=3)]).matches
    assert match.axis_error_deg == pytest.approx(8.0)
    assert match.heading_error_deg is None
    assert not match.flipped


def test_nothing_found_and_nothing_to_find():
    nothing_found = score([truth(0.0)], [])
    assert nothing_found.recall == 0.0
    assert nothing_found.precision is None
    nothing_there = score([truth(0.0, ignore=True)], [detection(9.0)])
    assert nothing_there.recall is None
    assert nothing_there.precision == 0.0
    assert precision_recall([truth(0.0)], [], 1.5, "any").average_precision == 0.0
    assert percentiles([None], 50) == [None]


def test_curve():
    truths = [truth(0.0), truth(10.0), truth(20.0), truth(30.0, ignore=True)]
    detections = [
        detection(0.0, number=0, score=0.9),
        detection(50.0, number=1, score=0.8),
        detection(10.0, number=2, score=0.7, fate="rejected"),
        detection(30.0, number=3, score=0.6),
        # no second candidate for the same place
        detection(10.2, number=4, score=0.5, fate="rejected"),
        detection(11.8, number=5, score=0.4, fate="duplicate", reason="as 2"),
    ]
    curve = precision_recall(truths, detections, 1.5, "any")
    np.testing.assert_allclose(curve.score, [0.9, 0.8, 0.7, 0.6])
    np.testing.assert_allclose(curve.recall, [1 / 3, 1 / 3, 2 / 3, 2 / 3])
    np.testing.assert_allclose(curve.precision, [1, 1 / 2, 2 / 3, 2 / 3])
    assert curve.average_precision == pytest.approx(1 / 3 + 2 / 9)


def test_curve_takes_equal_scores_together():
    detections = [detection(50.0, number=0, score=0.5), detection(0.0, number=1, score=0.5)]
    curve = precision_recall([truth(0.0)], detections, 1.5, "any")
    np.testing.assert_allclose(curve.precision, [0.5])


@given(
    st.lists(st.floats(0, 6), min_size=1, max_size=6),
    st.lists(st.floats(0, 6), max_size=6),
)
def test_curve_ends_with_the_score_of_all(places, found):
    truths = [truth(x) for x in places]
    detections = [detection(x, number=i, score=1 - 0.1 * i) for i, x in enumerate(found)]
    result = score(truths, detections)
    curve = precision_recall(truths, detections, 1.5, "any")
    if detections:
        assert curve.recall[-1] == pytest.approx(result.recall)
        assert curve.precision[-1] == pytest.approx(result.precision)
