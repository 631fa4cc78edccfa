"""Charts as PNG."""

import numpy as np
import pytest
from PIL import Image

from spinpipe.pipeline.evaluation.chart import COLOURS, Chart, Curve, draw_chart, round_ticks


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [(0, 0.4, [0, 0.1, 0.2, 0.3, 0.4]), (0, 8.4, [0, 2, 4, 6, 8]), (3, 17, [5, 10, 15])],
)
def test_round_ticks(low, high, ticks):
    assert round_ticks(low, high) == pytest.approx(ticks)


def test_chart_shows_its_curves_and_is_the_same_each_time(tmp_path):
    curves = [
        Curve("found", [0, 0.1, 0.2], [4, 4, 1]),
        Curve("false", [0, 0.1, 0.2], [0, 2, 900], colour=1, dashed=True),
    ]
    chart = Chart("Noise", "sigma, m", "cars", curves, y_most=10, level=(4.0, "all"))
    for name in ("a.png", "b.png"):
        draw_chart(chart, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    for colour in COLOURS[:2]:
        assert (pixels == colour).all(axis=2).sum() > 200


def test_single_point(tmp_path):
    draw_chart(Chart("One", "x", "y", [Curve("a", [1], [0])]), tmp_path / "one.png")
    assert Image.open(tmp_path / "one.png").size == (1200, 720)
