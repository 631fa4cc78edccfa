"""How a viewer lays out a run: scene, correlation, a candidate close by, and why it won or lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from spinpipe.pipeline import palette
from spinpipe.pipeline.draw_model import model_bounds, model_path
from spinpipe.pipeline.drawing import CANDIDATE, NOTES, WORLD, Reader
from spinpipe.schemas import MODELS, TILES, UPRIGHT
from spinpipe.schemas.records import F64, ObjectModel

_STEPS_SHOWN = 40


def build_blueprint(read: Reader, timeline: str = "stage") -> rrb.Blueprint:
    """Lay out the views of a run that has finished ``ingest``, with eyes that see the cloud.

    Parameters
    ----------
    read : reader of the run
    timeline : the one that is active when a viewer opens the recording
    """
    tiles, models, upright = read(TILES)[0], read(MODELS), read(UPRIGHT)
    T_world_local = upright[0].T_world_local if len(upright) else np.eye(4)
    centre, extent = _bounds(tiles.low, tiles.high, T_world_local)
    # the distance between neighbours, if the points lay on a flat square
    spacing = float(np.sqrt(extent[0] * extent[1] / max(int(tiles.counts.sum()), 1)))
    scene_eye, object_eye = _scene_eye(centre, extent), _object_eye(models)
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
                    rr.Points3D.from_fields(radii=-1.0),
                ),
                _view_3d(
                    "Correlation with the model's spin image",
                    ["+ /scan/correlation/**", *marks],
                    WORLD,
                    scene_eye,
                    rr.Points3D.from_fields(radii=-1.0),
                ),
            ),
            rrb.Vertical(
                rrb.Horizontal(
                    _view_3d(
                        "Candidate",
                        ["+ /ingest/cloud/**", "+ /verify/fit/**"],
                        CANDIDATE,
                        object_eye,
                        rr.Points3D.from_fields(radii=0.6 * spacing),
                    ),
                    rrb.TextDocumentView(origin=NOTES, name="Notes"),
                ),
                _spin_images([model.name for model in models]),
                rrb.Tabs(
                    _residuals(),
                    rrb.BarChartView(
                        origin="/scan/histogram", name="Correlations: log10(1 + origins)"
                    ),
                    rrb.DataframeView(
                        origin="/verify/ledger",
                        name="Ledger",
                        query=rrb.archetypes.DataframeQuery(timeline="candidate"),
                    ),
                    rrb.Spatial3DView(
                        origin="/ingest/models",
                        name="Models",
                        background=palette.BACKGROUND,
                        eye_controls=object_eye,
                    ),
                ),
                row_shares=[5, 3, 4],
            ),
            column_shares=[4, 3],
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
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        name=name,
        contents=contents,
        spatial_information=rrb.SpatialInformation(frame),
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=eye,
        defaults=[default],
    )


def _spin_images(models: Sequence[str]) -> rrb.Tabs:
    pairs: list[rrb.Horizontal] = []
    for model in models:
        path = model_path("/scan/spin_image", model)
        pairs.append(
            rrb.Horizontal(
                rrb.Spatial2DView(origin=f"{path}/model", name=f"Spin image of {model}"),
                rrb.Spatial2DView(origin=f"{path}/scene", name="Best match in the scene"),
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
            name="By iteration: residual of every start in metres. By candidate: scores",
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


def _bounds(low: np.ndarray, high: np.ndarray, T_world_local: F64) -> tuple[F64, F64]:
    """Centre and extent of the cloud in the world, metres, from the bounds of its tiles."""
    corners = np.array([low, high], np.float64)
    grid = np.stack(np.meshgrid(*([[0, 1]] * 3), indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.concatenate([corners[g, :, np.arange(3)].T for g in grid])
    world = points @ T_world_local[:3, :3].T + T_world_local[:3, 3]
    return (world.min(axis=0) + world.max(axis=0)) / 2, np.ptp(world, axis=0)


def _scene_eye(centre: F64, extent: F64) -> rrb.EyeControls3D:
    """Look down at the cloud across its longer side, so that it fills a wide view."""
    along = 0 if extent[0] >= extent[1] else 1
    length, depth = extent[along], extent[1 - along]
    distance = max(0.45 * length, 0.75 * depth)
    offset = np.array([0.0, 0.0, 0.9])
    offset[1 - along] = -0.75
    return rrb.EyeControls3D(
        position=centre + distance * offset, look_target=centre, eye_up=(0.0, 0.0, 1.0)
    )


def _object_eye(models: Sequence[ObjectModel]) -> rrb.EyeControls3D:
    """Look at the object frame's origin from ahead, aside and above."""
    sizes = [np.diff(model_bounds(model), axis=0)[0] for model in models]
    size = max((float(np.linalg.norm(s)) for s in sizes), default=1.0)
    height = max((float(s[2]) for s in sizes), default=0.0)
    return rrb.EyeControls3D(
        position=(0.7 * size, -0.95 * size, 0.8 * size),
        look_target=(0.0, 0.0, height / 2),
        eye_up=(0.0, 0.0, 1.0),
    )
