"""What speaks for and against a fit: rows, noise at steps, wrong shapes, thin plates."""

import numpy as np
import pytest
from tests.unit.verify.standing import cloud_of, found_in, known_object, verdicts_on

from spinpipe.stages.geometry.shapes import Mesh, box, cylinder, merged, placed, sample_surface
from spinpipe.stages.verify.decide.decision import decide
from spinpipe.stages.verify.decide.verdict import Rules
from spinpipe.stages.verify.judge.scoring import log_odds
from spinpipe.stages.verify.model.field import build_model_field

CABINET = box(0.9, 0.45, 1.2)
LATHE = merged(
    [
        *(placed(box(0.5, 0.5, 0.6), (x, 0, 0)) for x in (-0.65, 0.65)),
        placed(box(1.9, 0.45, 0.2), (0, 0, 0.6)),
        placed(box(0.5, 0.5, 0.45), (-0.68, 0, 0.8)),
        placed(box(0.3, 0.55, 0.14), (0, 0, 0.8)),
    ]
)


def part(verdict, name):
    """What a verdict gives a part of the score."""
    return next(part.value for part in verdict.parts if part.name == name)


def test_a_row_of_instances_is_found_whatever_touches_them():
    """Neighbours explain each other; a lower body beside them is no continuation."""
    row = [placed(CABINET, (0, 0.5 * k, 0)) for k in range(3)]
    lower = placed(box(0.9, 0.45, 0.7), (0, -0.46, 0))
    cloud = cloud_of([*row, lower], 8, 2000, noise=0.01)
    verdicts = verdicts_on(
        cloud, [known_object("cabinet", CABINET)], [(0, 0.5 * k, 1.2) for k in range(3)]
    )
    assert [v.fate for v in verdicts] == ["accepted"] * 3


def test_a_level_body_that_goes_on_is_no_instance_in_a_row():
    deeper = box(0.9, 0.7, 1.2)
    verdicts = verdicts_on(
        cloud_of([deeper], 8, 2000, noise=0.01), [known_object("cabinet", CABINET)], [(0, 0, 1.2)]
    )
    assert verdicts[0].fate != "accepted"


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_box_is_no_barrel(noise):
    barrel, crate = cylinder(0.29, 0.88, 24), box(0.58, 0.58, 0.88)
    cloud = cloud_of([placed(crate, (0, 0, 0)), placed(barrel, (2, 0, 0))], 8, 900, noise)
    verdicts = verdicts_on(cloud, [known_object("barrel", barrel)], [(0, 0, 0.88), (2, 0, 0.88)])
    assert [v.fate for v in verdicts] == ["rejected", "accepted"]


def test_steps_are_no_contradiction_in_noise():
    cloud = cloud_of([LATHE], 10, 700, noise=0.07)
    known = known_object("lathe", LATHE)
    verdict = verdicts_on(cloud, [known], [(-0.68, 0, 1.25)])[0]
    assert verdict.evidence["contradicted"] < 0.05
    assert part(verdict, "model") > 0.9


def test_the_underside_of_a_plate_is_not_seen_from_above():
    bench = merged([placed(box(0.4, 1.8, 0.05), (0, 0, 0.42)), box(0.3, 0.08, 0.42)])
    points, normals = sample_surface(*bench, 40_000, np.random.default_rng(0))
    field = build_model_field("bench", points, normals)
    low = field.probes[:, 2] < 0.45
    assert field.seen_weight[low].sum() < 0.1


def test_a_right_instance_scores_high_in_any_cloud():
    """Scores are relative to what a right instance gets: noise does not lower them."""
    places = np.array([(0, 0, 1.2)])
    for noise in (0.0, 0.05):
        cloud = cloud_of([CABINET], 5, 2000, noise)
        found = found_in(cloud, [known_object("cabinet", CABINET)], places)
        reference = found.standards.reference
        assert log_odds(reference, reference)[0] > 3
        assert decide(found.standards, found.table, places, Rules())[0].score > 0.9


def test_what_falls_past_its_base_stands_on_nothing():
    """A crown or a heap that looks like the model from above goes on below it."""
    model, heap = _frustum(0.8, 0.4, 0.8), _frustum(2.0, 0.4, 3.2)
    hedge = placed(box(6.0, 1.0, 2.4), (0, -2.4, 0))  # a level to stand on, beside it
    cloud = cloud_of([heap, hedge, placed(model, (5, 3, 0))], 13, 300, noise=0.01)
    known = known_object("pedestal", model, visible_from="above")
    on_heap, on_ground = verdicts_on(cloud, [known], [(0, 0, 3.2), (5, 3, 0.8)])
    assert on_ground.fate == "accepted"
    assert on_ground.evidence["grounded"] == 1.0
    assert on_heap.fate == "rejected"
    assert on_heap.evidence["grounded"] < 0.5


def _frustum(bottom, top, height):
    vertices, faces = cylinder(1.0, height, 32)
    radius = np.where(vertices[:, 2:] > height / 2, top, bottom)
    return Mesh(vertices * np.c_[radius, radius, np.ones(len(vertices))], faces)


def test_the_ends_tell_where_along_its_axis_a_long_object_stands():
    """In a tight row only a small part of the outline does."""
    wagon = box(6.0, 1.0, 1.2)
    row = [placed(wagon, (0, 1.1 * k, 0)) for k in range(5)]
    cloud = cloud_of(row, 16, 400, noise=0.03)
    known = known_object("wagon", wagon, visible_from="above")
    places = [(-1.5 + 0.7 * k, 1.1 * k, 1.2) for k in range(5)]
    verdicts = verdicts_on(cloud, [known], places)
    assert [v.fate for v in verdicts] == ["accepted"] * 5
    assert np.abs([v.pose[0] for v in verdicts]).max() < 0.15


def test_what_fits_worse_than_all_instances_of_the_scene_is_none():
    barrel, crate = cylinder(0.29, 0.88, 24), box(0.58, 0.58, 0.88)
    row = [placed(barrel, (1.5 * k, 0, 0)) for k in range(-2, 2)]
    cloud = cloud_of([*row, placed(crate, (0, 2, 0))], 9, 900, 0.03)
    places = [(1.5 * k, 0, 0.88) for k in range(-2, 2)] + [(0, 2, 0.88)]
    *right, wrong = verdicts_on(cloud, [known_object("barrel", barrel)], places)
    assert min(part(v, "alike") for v in right) > 0.3
    assert [v.fate for v in right] == ["accepted"] * 4
    assert part(wrong, "alike") < 0.05
    assert wrong.fate == "rejected"
