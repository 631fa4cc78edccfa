"""Verification by evidence on scenes whose truth is known: cars, furniture, decoys, half views."""

import numpy as np
import pytest
from tests.unit.verify.standing import cloud_of, found_in, known_object, verdicts_on

from spinpipe.stages.geometry.sampling import measure_sampling
from spinpipe.stages.geometry.shapes import Mesh, box, cylinder, merged, placed
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.scoring import PARTS


def _turn_deg(a, b):
    return abs((np.degrees(a - b) + 180) % 360 - 180)


@pytest.fixture(scope="module")
def cars():
    return [known_object(k, Mesh(*vehicle_mesh(k))) for k in ("saloon", "van")]


@pytest.fixture(scope="module")
def lot():
    saloon, van = (Mesh(*vehicle_mesh(k)) for k in ("saloon", "van"))
    return [
        placed(saloon, (-5, 0, 0), 20),
        placed(van, (5, 0, 0), 110),
        placed(box(4.5, 1.8, 1.4), (0, 6, 0), 0),
        placed(saloon, (-5, 2.4, 0), 200),
    ]


PLACES = [[-5, 0.1, 1.42], [5.1, 0, 1.95], [0, 6, 1.4], [-4.8, 2.4, 1.42], [8, 8, 1.4]]


@pytest.mark.parametrize("noise", [0.0, 0.08])
def test_right_type_place_and_heading(cars, lot, noise):
    verdicts = verdicts_on(cloud_of(lot, 24, 110, noise), cars, PLACES)
    fates = [v.fate for v in verdicts]
    assert fates == ["accepted", "accepted", "rejected", "accepted", "rejected"]
    for k, model, x, y, heading in ((0, 0, -5, 0, 20), (1, 1, 5, 0, 110), (3, 0, -5, 2.4, 200)):
        v = verdicts[k]
        assert v.model == model
        assert np.hypot(v.pose[0] - x, v.pose[1] - y) < (0.03 if noise == 0 else 0.08)
        assert _turn_deg(v.pose[3], np.radians(heading)) < (1 if noise == 0 else 2)
        assert v.heading_margin > 0.01
        assert [part.name for part in v.parts] == list(PARTS)
        assert all(0 <= part.value <= 1 for part in v.parts)
        assert v.score > 0.8
    assert "below 0.5" in verdicts[2].reason


def test_one_instance_one_detection(cars, lot):
    cloud = cloud_of(lot, 24, 110)
    verdicts = verdicts_on(cloud, cars, [[-5, 0.1, 1.42], [-4.6, 0.2, 1.4], [-5.5, -0.2, 1.38]])
    assert [v.fate for v in verdicts].count("accepted") == 1
    assert [v.cause for v in verdicts].count("duplicate") == 2
    kept = next(v.candidate for v in verdicts if v.fate == "accepted")
    assert all(v.duplicate_of == kept for v in verdicts if v.fate == "duplicate")


def test_in_a_row_each_candidate_stands_for_the_car_it_lies_on(cars):
    rng = np.random.default_rng(0)
    saloon, across = Mesh(*vehicle_mesh("saloon")), 2.0 * np.arange(5)
    cloud = cloud_of(
        [placed(saloon, (x, 0, 0), 90 + rng.normal(0, 2)) for x in across], 24, 60, 0.05, 0
    )
    places = [[x + rng.uniform(-0.75, 0.75), rng.uniform(-0.9, 0.9), 1.4] for x in across]
    verdicts = verdicts_on(cloud, cars[:1], places)  # two of them slide into each other's place
    assert [v.fate for v in verdicts] == ["accepted"] * 5
    assert [v.pose[0] for v in verdicts] == pytest.approx(across, abs=0.1)


def test_threads_order_and_blocks_leave_no_trace(cars, lot):
    cloud = cloud_of(lot, 24, 110, 0.03)
    sampling = measure_sampling(cloud)
    places = np.array(PLACES, float)
    first = verdicts_on(cloud, cars, places, sampling=sampling, threads=1)
    shuffled = cloud[np.random.default_rng(9).permutation(len(cloud))]
    other = verdicts_on(shuffled, cars, places, sampling=sampling, threads=3)
    for a, b in zip(first, other, strict=True):
        assert np.array_equal(a.pose, b.pose)
        assert (a.fate, a.reason, a.score) == (b.fate, b.reason, b.score)


def test_courses_lead_from_the_start_to_the_fit(cars, lot):
    cloud = cloud_of(lot, 24, 110)
    found = found_in(cloud, cars, PLACES)
    table = found.table
    assert {0, 1, 3} <= set(found.courses)
    ends: set[int] = set()
    for candidate, courses in found.courses.items():
        for course in courses:
            rows = np.flatnonzero(table.candidate == candidate)
            (k,) = rows[(table.pose[rows] == course.poses[-1]).all(axis=1)]
            assert np.array_equal(course.poses[0], table.start[k])
            assert course.rms_m[-1] == table.evidence[k, EVIDENCE.index("rms_m")]
            assert 2 < len(course.poses) == len(course.rms_m)
            ends.add(int(k))
    best = table.best_rows()
    assert set(best[np.isin(table.candidate[best], list(found.courses))].tolist()) <= ends


def test_turned_and_shifted_scene_moves_detections_with_it(cars, lot):
    cloud = cloud_of(lot, 24, 110, 0.02)
    angle, shift = 0.7, np.array([31.0, -17.0, 0.0])
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    before = verdicts_on(cloud, cars, PLACES)
    after = verdicts_on(cloud @ R.T + shift, cars, np.array(PLACES) @ R.T + shift)
    for a, b in zip(before, after, strict=True):
        assert a.fate == b.fate
        if a.fate == "accepted":
            assert np.linalg.norm(R @ a.pose[:3] + shift - b.pose[:3]) < 0.01
            assert _turn_deg(a.pose[3] + angle, b.pose[3]) < 0.5  # other points are kept


def test_ground_seen_through_it_denies_a_ghost(cars):
    """A tenth of the density on the body, all of the ground below it: it left before."""
    rng = np.random.default_rng(2)
    car = placed(Mesh(*vehicle_mesh("saloon")), (0, 0, 0), 30)
    cloud = cloud_of([car], 16, 150)
    body = cloud[:, 2] > 0.05
    ghost = cloud[~body | (rng.random(len(cloud)) < 0.08)]
    place = [[0.0, 0.0, 1.42]]
    assert verdicts_on(cloud, cars, place)[0].fate == "accepted"
    assert verdicts_on(ghost, cars, place)[0].fate == "rejected"


def test_what_goes_on_beyond_the_outline_is_no_instance():
    plateau = placed(box(14, 14, 1.4), (0, 0, 0))
    cloud = cloud_of([plateau], 30, 110)
    cars = [known_object(k, Mesh(*vehicle_mesh(k)), 0.15) for k in ("saloon", "van")]
    verdicts = verdicts_on(cloud, cars, [[0, 0, 1.4], [4, 0, 1.4], [5.5, 2, 1.4]])
    assert [v.fate for v in verdicts] == ["rejected"] * 3


def test_a_part_of_a_larger_body_is_ambiguous_what_only_touches_one_is_found():
    """A crate beside a block as high, and a block of twice its length and width."""
    crate, wide = box(1.2, 0.8, 0.9), box(2.4, 1.6, 0.9)
    objects = [
        placed(crate, (-4, 0, 0), 0),
        placed(box(0.9, 1.5, 0.9), (-4.1, 1.15, 0), 0),
        placed(wide, (4, 0, 0), 30),
    ]
    places = [[-4, 0, 0.9], [3.5, 0.1, 0.9], [4.4, 0, 0.9]]
    verdicts = verdicts_on(cloud_of(objects, 16, 400), [known_object("crate", crate)], places)
    assert verdicts[0].fate == "accepted", verdicts[0].reason
    assert [v.cause for v in verdicts[1:]] == ["continues", "continues"]


def test_seen_from_above_under_a_roof_or_cut_by_the_border(cars):
    car = placed(Mesh(*vehicle_mesh("saloon")), (0, 0, 0), 30)
    place = [[0.0, 0.0, 1.42]]
    roof = placed(box(7, 5, 0.05), (0, 0, 2.6), 30)
    tented = cloud_of([car, roof], 16, 110)
    assert verdicts_on(tented, cars, place)[0].fate == "accepted"
    declared = [known_object("saloon", Mesh(*vehicle_mesh("saloon")), visible_from="above")]
    hidden = verdicts_on(tented, declared, place)[0]
    assert hidden.fate == "ambiguous"
    assert "below something else" in hidden.reason
    whole = cloud_of([car], 16, 110)
    cut = whole[whole[:, 0] > -0.9]
    assert verdicts_on(cut, cars, place)[0].fate == "accepted"
    half = whole[(whole[:, 1] > 0) | (whole[:, 2] < 0.02) | (whole[:, 2] > 1.0)]
    assert verdicts_on(half, cars, place)[0].fate == "accepted"


def _chair():
    legs = [placed(box(0.05, 0.05, 0.43), (x, y, 0)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    seat = placed(box(0.45, 0.45, 0.05), (0, 0, 0.42))
    return merged([seat, placed(box(0.05, 0.45, 0.5), (-0.2, 0, 0.45)), *legs])


def _machine():
    tower = placed(box(0.5, 0.7, 0.6), (-0.35, 0, 0.9))
    return merged([box(1.4, 0.9, 0.9), tower, placed(cylinder(0.12, 0.5), (0.4, 0.2, 0.9))])


def test_furniture_barrels_and_machines_by_the_same_rule():
    objects = [
        known_object("chair", _chair()),
        known_object("barrel", cylinder(0.3, 0.9)),
        known_object("machine", _machine()),
    ]
    items = [
        placed(_chair(), (0, 0, 0), 40),
        placed(cylinder(0.3, 0.9), (2, 0, 0)),
        placed(_machine(), (-2, 1, 0), 250),
        placed(box(0.45, 0.45, 0.9), (0, 2.5, 0), 10),
        placed(cylinder(0.3, 0.6), (2.5, 2.5, 0)),
    ]
    cloud = cloud_of(items, 8, 700, 0.005)
    back = np.array([0, 0, 0.94]) - 0.2 * np.array(
        [np.cos(np.radians(40)), np.sin(np.radians(40)), 0]
    )
    tower = np.array([-2, 1, 1.5]) - 0.35 * np.array(
        [np.cos(np.radians(250)), np.sin(np.radians(250)), 0]
    )
    verdicts = verdicts_on(
        cloud, objects, [back, [2.1, 0, 0.9], tower, [0, 2.5, 0.9], [2.5, 2.5, 0.6]]
    )
    assert [v.fate for v in verdicts[:3]] == ["accepted"] * 3
    assert [v.model for v in verdicts[:3]] == [0, 1, 2]
    assert [v.fate for v in verdicts[3:]] == ["rejected"] * 2
    assert _turn_deg(verdicts[0].pose[3], np.radians(40)) < 2
    assert _turn_deg(verdicts[2].pose[3], np.radians(250)) < 2
    # a barrel looks the same from all sides: its heading is not in doubt
    assert verdicts[1].heading_margin == pytest.approx(verdicts[1].score)
