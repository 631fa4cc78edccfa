"""How a viewer lays out a run: the scene, a candidate close by, and why it won or lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from spinpipe.pipeline.drawing import courses, palette, parts
from spinpipe.pipeline.drawing.drawing import CANDIDATE, NOTES, WORLD, Reader
from spinpipe.pipeline.drawing.eye import diagonal, is_long, object_eye, scene_corners, scene_eye
from spinpipe.pipeline.drawing.model import model_path, places_in_row
from spinpipe.pipeline.drawing.photos import photos_of
from spinpipe.pipeline.drawing.preview import piece_count
from spinpipe.schemas import MODELS, TILES
from spinpipe.schemas.records import ObjectModel

Overrides = dict[rr.encodings.EntityPathLike, rr.Points3D | rrb.Visualizer]

_FILL, _LARGEST = 0.6, 0.015
"""Radius of a point close by, as a share of the spacing and at most of the object."""
_FAR_RADIUS = -1.5
"""Negative: on the screen. Radii in metres shrink below a pixel from afar and lose colour."""


def build_blueprint(read: Reader, preview_points: int, timeline: str = "stage") -> rrb.Blueprint:
    """Lay out the views of a run that has finished ``ingest``, with eyes that see the cloud.

    Parameters
    ----------
    read : reader of the run
    preview_points : most points of the cloud that are shown
    timeline : the one that is active when a viewer opens the recording
    """
    tiles, models = read(TILES)[0], read(MODELS)
    corners = scene_corners(read)
    eye = scene_eye(corners).controls()
    # distance between neighbours, if the points lay on a flat square
    shown = max(min(int(tiles.counts.sum()), preview_points), 1)
    spacing = float(np.sqrt(np.ptp(corners[:8], axis=0)[:2].prod() / shown))
    near_radius = min(_FILL * spacing, _LARGEST * diagonal(models))
    scene, *others = _scene_views(eye, piece_count(len(tiles.counts)))
    left = rrb.Vertical(scene, rrb.Tabs(*others)) if is_long(corners) else rrb.Tabs(scene, *others)
    photos = any(photo.file is not None for photo in photos_of(read))
    return rrb.Blueprint(
        rrb.Horizontal(left, _candidate(models, near_radius, photos), column_shares=[6, 5]),
        rrb.TimePanel(timeline=timeline, state="expanded"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scene_views(eye: rrb.EyeControls3D, pieces: int) -> list[rrb.Spatial3DView]:
    """The scene in its colours, by correlation, by height, and as the threshold falls."""
    far = rr.Points3D.from_fields(radii=_FAR_RADIUS)
    cloud, marks = "+ /ingest/cloud/**", ["+ /cluster/**", "+ /verify/**", "- /verify/fit/**"]
    photo = [
        cloud,
        "+ /ingest/cameras/**",
        "+ /ingest/trajectory/**",
        "+ /ground/**",
        "+ /scan/hits/**",
        *marks,
        "+ /candidate/box",
    ]
    past = rr.VisibleTimeRange(
        "threshold",
        start=rr.TimeRangeBoundary.infinite(),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )
    scored = [cloud, "+ /scan/correlation/**", *marks, "- /verify/labels"]
    falling: Overrides = _faded(pieces) | {
        "threshold/hits": rr.Points3D.from_fields(colors=palette.HIT, radii=-2.0),
        "threshold/candidates": rr.Points3D.from_fields(colors=palette.WHITE, radii=-3.0),
    }
    height: Overrides = {
        f"ingest/cloud/{i:04d}": rr.Points3D.from_fields(radii=_FAR_RADIUS).visualizer(
            mappings=[
                VisualizerComponentMapping(
                    target="Points3D:colors",
                    source_kind=ComponentSourceKind.SourceComponent,
                    source_component="Height:colors",
                )
            ]
        )
        for i in range(pieces)
    }
    return [
        _view_3d("Scene, in the photos' colours", photo, WORLD, eye, far),
        _view_3d(
            "Correlation with the model's spin image", scored, WORLD, eye, far, _faded(pieces)
        ),
        _view_3d("Height", [cloud, *marks, "- /verify/labels"], WORLD, eye, far, height),
        _view_3d(
            "Threshold (timeline 'threshold')",
            [cloud, "+ /threshold/**", "- /threshold/counts"],
            WORLD,
            eye,
            far,
            falling,
            past,
        ),
    ]


def _candidate(models: Sequence[ObjectModel], near_radius: float, photos: bool) -> rrb.Vertical:
    """One candidate: what is explained, its looks, its numbers, its spin image, its way."""
    eye, near = (
        object_eye(models, np.zeros(1)).controls(),
        rr.Points3D.from_fields(radii=near_radius),
    )
    own: Overrides = {
        "candidate/points": rr.Points3D.from_fields(radii=-2.0),
        "candidate/surface": rr.Points3D.from_fields(radii=-2.2),
    }
    shapes = ("points", "box", "runner_up", "next_model", "names")
    explained = [f"+ /candidate/{name}" for name in shapes]
    surface = ["+ /candidate/surface", "+ /candidate/box"]
    fit = ["+ /ingest/cloud/**", "+ /verify/fit/**", "+ /candidate/runner_up"]
    notes = rrb.TextDocumentView(origin=NOTES, name="Notes")
    photo = rrb.Spatial2DView(origin="/candidate/photo", name="Photo")
    return rrb.Vertical(
        rrb.Horizontal(
            rrb.Tabs(
                _view_3d("Explained", explained, CANDIDATE, eye, near, own),
                _view_3d("Seen", surface, CANDIDATE, eye, near, own),
                _view_3d("Fit", fit, CANDIDATE, eye, near),
            ),
            rrb.Vertical(photo, notes, row_shares=[5, 6]) if photos else notes,
        ),
        rrb.Horizontal(
            _chart(parts.PATH, "Its score, part by part", parts.BOUNDS),
            rrb.Spatial2DView(
                origin="/candidate/spin", name="Spin images", background=palette.BACKGROUND
            ),
        ),
        rrb.Tabs(
            _chart(courses.PATH, "Registration: residual of every start", courses.BOUNDS),
            _histograms([model.name for model in models]),
            rrb.TimeSeriesView(
                origin="/threshold/counts", name="How many by threshold, log10", axis_x=_all_steps()
            ),
            rrb.DataframeView(
                origin="/verify/ledger",
                name="Ledger",
                query=rrb.archetypes.DataframeQuery(timeline="candidate"),
            ),
            rrb.Spatial3DView(
                origin="/model/objects",
                name="Models",
                background=palette.BACKGROUND,
                eye_controls=object_eye(models, places_in_row(models)).controls(),
            ),
        ),
        row_shares=[12, 6, 6],
    )


def _view_3d(
    name: str,
    contents: list[str],
    frame: str,
    eye: rrb.EyeControls3D,
    default: rr.Points3D,
    overrides: Overrides | None = None,
    time_range: rr.VisibleTimeRange | None = None,
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=name,
        contents=contents,
        spatial_information=rrb.SpatialInformation(frame),
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=eye,
        defaults=[default],
        overrides=overrides,
        time_ranges=time_range,
    )


def _faded(pieces: int) -> Overrides:
    """Cloud in one dark grey behind what is to be seen."""
    cloud = rr.Points3D.from_fields(colors=palette.SHADOW, radii=_FAR_RADIUS / 2)
    faded: Overrides = {f"ingest/cloud/{i:04d}": cloud for i in range(pieces)}
    return faded


def _histograms(models: Sequence[str]) -> rrb.Tabs | rrb.Horizontal:
    views = [
        rrb.BarChartView(
            origin=model_path("/scan/histogram", model),
            name=f"{model}: correlations, log10",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for model in models
    ]
    return rrb.Tabs(*views, name="Correlations")


def _chart(
    path: str, name: str, bounds: tuple[tuple[float, float], tuple[float, float]]
) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin=f"/{path}",
        name=name,
        background=palette.BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=bounds[0], y_range=bounds[1]),
    )


def _all_steps() -> rrb.TimeAxis:
    return rrb.TimeAxis(
        view_range=rr.TimeRange(
            start=rr.TimeRangeBoundary.absolute(seq=0), end=rr.TimeRangeBoundary.absolute(seq=100)
        )
    )
