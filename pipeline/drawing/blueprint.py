"""How a viewer lays out a run: scene, correlation, a candidate close by, and why it won or lost."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import CANDIDATE, NOTES, WORLD, Reader
from spinpipe.pipeline.drawing.model import model_bounds, model_path, places_in_row
from spinpipe.pipeline.drawing.preview import piece_count
from spinpipe.schemas import MODELS, TILES, UPRIGHT
from spinpipe.schemas.records import F64, ObjectModel, TileIndex

Overrides = dict[rr.encodings.EntityPathLike, rr.Points3D | rr.Boxes3D]

_STEPS_SHOWN = 40
_FILL, _LARGEST = 0.6, 0.015
"""Radius of a point close by, as a share of the spacing and at most of the object."""
_FAR_RADIUS = -1.5
"""Negative: on the screen. Radii in metres shrink below a pixel from afar and lose colour."""
_DOWN_DEG = 42.0
_TAN_UP, _TAN_ACROSS = 0.48, 1.05
"""Half the view's angles: Rerun opens 55 degrees upwards, and the views are wide."""


def build_blueprint(read: Reader, preview_points: int, timeline: str = "stage") -> rrb.Blueprint:
    """Lay out the views of a run that has finished ``ingest``, with eyes that see the cloud.

    Parameters
    ----------
    read : reader of the run
    preview_points : most points of the cloud that are shown
    timeline : the one that is active when a viewer opens the recording
    """
    tiles, models, upright = read(TILES)[0], read(MODELS), read(UPRIGHT)
    corners = _corners(tiles, upright[0].T_world_local if len(upright) else np.eye(4))
    scene_eye, object_eye = _scene_eye(corners), _object_eye(models, np.zeros(1))
    # distance between neighbours, if the points lay on a flat square
    shown = max(min(int(tiles.counts.sum()), preview_points), 1)
    spacing = float(np.sqrt(np.ptp(corners, axis=0)[:2].prod() / shown))
    near_radius = min(_FILL * spacing, _LARGEST * _diagonal(models))
    far, near = (rr.Points3D.from_fields(radii=r) for r in (_FAR_RADIUS, near_radius))
    marks = ["+ /cluster/**", "+ /verify/**", "- /verify/fit/**"]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _view_3d(
                    "Scene, in the photos' colours",
                    [
                        "+ /ingest/cloud/**",
                        "+ /ingest/cameras",
                        "+ /ground/**",
                        "+ /scan/hits/**",
                        *marks,
                    ],
                    WORLD,
                    scene_eye,
                    far,
                ),
                _view_3d(
                    "Correlation with the model's spin image",
                    ["+ /ingest/cloud/**", "+ /scan/correlation/**", *marks],
                    WORLD,
                    scene_eye,
                    far,
                    overrides=_faded(piece_count(len(tiles.counts))),
                ),
            ),
            rrb.Vertical(
                rrb.Horizontal(
                    _view_3d(
                        "Candidate",
                        ["+ /ingest/cloud/**", "+ /verify/fit/**"],
                        CANDIDATE,
                        object_eye,
                        near,
                    ),
                    rrb.TextDocumentView(origin=NOTES, name="Notes"),
                ),
                _spin_images([model.name for model in models]),
                rrb.Tabs(
                    _residuals(),
                    rrb.DataframeView(
                        origin="/verify/ledger",
                        name="Ledger",
                        query=rrb.archetypes.DataframeQuery(timeline="candidate"),
                    ),
                    rrb.Spatial3DView(
                        origin="/ingest/models",
                        name="Models",
                        background=palette.BACKGROUND,
                        eye_controls=_object_eye(models, places_in_row(models)),
                    ),
                ),
                row_shares=[5, 3, 4],
            ),
            column_shares=[6, 5],
        ),
        rrb.TimePanel(timeline=timeline, state="expanded"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _view_3d(
    name: str,
    contents: list[str],
    frame: str,
    eye: rrb.EyeControls3D,
    default: rr.Points3D,
    overrides: Overrides | None = None,
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
    )


def _faded(pieces: int) -> Overrides:
    """Cloud in one dark grey behind the origins that were scored, and boxes without labels."""
    cloud = rr.Points3D.from_fields(colors=palette.SHADOW, radii=_FAR_RADIUS / 2)
    boxes = rr.Boxes3D.from_fields(show_labels=False)
    faded: Overrides = {f"ingest/cloud/{i:04d}": cloud for i in range(pieces)}
    faded |= {"verify/accepted": boxes, "verify/ambiguous": boxes}
    return faded


def _spin_images(models: Sequence[str]) -> rrb.Tabs:
    pairs: list[rrb.Horizontal] = []
    for model in models:
        path = model_path("/scan/spin_image", model)
        pairs.append(
            rrb.Horizontal(
                rrb.Spatial2DView(origin=f"{path}/model", name="Model"),
                rrb.Spatial2DView(origin=f"{path}/scene", name="Best match"),
                rrb.BarChartView(
                    origin=model_path("/scan/histogram", model),
                    name="Correlations, log10",
                    plot_legend=rrb.PlotLegend(visible=False),
                ),
                name=model,
            )
        )
    return rrb.Tabs(*pairs, name="Spin images")


def _residuals() -> rrb.Vertical:
    near = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seq=-_STEPS_SHOWN),
        end=rr.TimeRangeBoundary.cursor_relative(seq=_STEPS_SHOWN),
    )
    return rrb.Vertical(
        rrb.TimeSeriesView(
            contents=["+ /verify/rms/**", "+ /verify/numbers"],
            name="Iterations: residual of every start in m. "
            "Candidates: ● score ◆ correlation ▲ model, ▼ scene explained",
            axis_x=rrb.TimeAxis(view_range=near),
            plot_legend=rrb.PlotLegend(visible=False),
        ),
        rrb.StateTimelineView(
            origin="/verify/fate",
            name="Fate",
            time_view=rrb.TimeAxis(view_range=near),
            titlebar=False,
        ),
        row_shares=[2, 1],
        name="Residuals",
    )


def scene_eye(read: Reader) -> rrb.EyeControls3D:
    """An eye that sees the whole upright cloud."""
    return _scene_eye(_corners(read(TILES)[0], read(UPRIGHT)[0].T_world_local))


def _corners(tiles: TileIndex, T_world_local: F64) -> F64:
    """(8, 3) corners of the cloud's bounding box in the world, metres."""
    low, high = tiles.low.min(axis=0).tolist(), tiles.high.max(axis=0).tolist()
    corners = np.array(list(product(*zip(low, high, strict=True))))
    return corners @ T_world_local[:3, :3].T + T_world_local[:3, 3]


def _scene_eye(corners: F64) -> rrb.EyeControls3D:
    """Look down at a box across its longer side, from as near as all its corners are in view."""
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    length, width, height = np.ptp(corners, axis=0)
    # what makes the box high is a tree or a pole, seldom in the corner next to the eye
    low = corners - np.where(corners[:, 2:] > centre[2], (0, 0, 0.4 * height), 0)
    right = np.array([1.0, 0.0, 0.0]) if length >= width else np.array([0.0, -1.0, 0.0])
    ahead, down = np.cross([0.0, 0.0, 1.0], right), np.deg2rad(_DOWN_DEG)
    forward = ahead * np.cos(down) - [0.0, 0.0, np.sin(down)]
    eyes: list[tuple[float, F64, F64]] = []
    for shift in np.linspace(0, 0.5, 11) * min(length, width):  # the near side looms larger
        target = centre - shift * ahead
        x, y, depth = ((low - target) @ a for a in (right, np.cross(right, forward), forward))
        back = np.max(np.maximum(abs(x) / _TAN_ACROSS, abs(y) / _TAN_UP) - depth)
        eye = target - back * forward
        eyes.append((float((centre - eye) @ forward), eye, target))
    _, eye, target = min(eyes, key=lambda view: view[0])
    return rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0.0, 0.0, 1.0))


def _diagonal(models: Sequence[ObjectModel], extra: float = 0.0) -> float:
    """Diagonal of a box that holds any of the models, metres; ``extra`` makes it wider."""
    sizes = np.array([np.ptp(model_bounds(model), axis=0) for model in models]).reshape(-1, 3)
    return max(float(np.linalg.norm(sizes.max(axis=0, initial=0) + (0.0, extra, 0.0))), 1e-3)


def _object_eye(models: Sequence[ObjectModel], places: F64) -> rrb.EyeControls3D:
    """Look at models that stand at ``places`` along y from ahead, aside and above."""
    size = _diagonal(models, float(np.ptp(places)))
    return rrb.EyeControls3D(
        position=(0.7 * size, -0.95 * size, 0.8 * size),
        look_target=(0.0, 0.0, 0.12 * size),
        eye_up=(0.0, 0.0, 1.0),
    )
