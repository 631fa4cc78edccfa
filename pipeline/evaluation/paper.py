"""``spinpipe paper``: section 3 of [Bovenkamp 2010] repeated, its numbers beside ours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from spinpipe.pipeline.atomic import scratch_folder, write_atomically
from spinpipe.pipeline.config import ConfigError
from spinpipe.pipeline.evaluation.chart import Chart, Curve, draw_chart
from spinpipe.pipeline.evaluation.evaluate import evaluate_run
from spinpipe.pipeline.evaluation.evaluation import Match
from spinpipe.pipeline.evaluation.experiments import (
    ARTIFICIAL_BIN_M,
    BINS_M,
    MAX_CANDIDATES,
    NOISE_M,
    SAMPLES,
    ArtificialExperiment,
    Found,
    Residuals,
    labels_of,
    noise_scene,
    paper_settings,
    residuals,
    run_scene,
    seen_from_above_scene,
)
from spinpipe.pipeline.evaluation.paper_report import Section, markdown, section_table
from spinpipe.pipeline.evaluation.picture import write_picture
from spinpipe.pipeline.outputs import locked
from spinpipe.pipeline.run_folder import RunFolder

INTRO = """\
The experiments of section 3 of E. Bovenkamp et al., "Single Spin Image-ICP Matching for Efficient
3D Object Recognition", 3DOR 2010, repeated by `spinpipe paper`. The scene is made from code after
the paper's description (250,000 points, four cars of each of two models, one car of model 1 under
a tent, trees, poles, boxes, a house); it is not the paper's own, so numbers compare in kind.
"Found" counts cars with a candidate or a detection within 1.5 m, one each; "false" are those on no
car. Which way is up is known, as in the paper. "The paper's recipe" is its scan and clustering with
its numbers; "spinpipe" is the whole pipeline with its defaults."""
FILES = (
    *("paper.md", "paper_scene.png", "paper_noise_found.png", "paper_noise_false.png"),
    "paper_residuals.png",
)
CARS = 4
LARGEST_SHOWN = 12
"""Counts above are drawn at the border of a figure: they reach hundreds."""


def paper_command(
    output: Path, scene: Path | None, model: Path | None, truth: Path | None, force: bool
) -> None:
    """``spinpipe paper``."""
    own = (scene, model, truth)
    if any(own) and not all(own):
        raise ConfigError("paper: --scene, --model and --truth belong together: give all or none")
    console = Console()
    with locked(output, force=force) as outputs:
        outputs.claim(*(output / name for name in FILES))
        sections: list[Section] = []
        with scratch_folder(output) as scratch:
            for section in _sections(scratch, output, scene, model, truth):
                console.print(section_table(section), highlight=False)
                sections.append(section)
        text = markdown("The paper's experiments, repeated", INTRO, sections)
        write_atomically(output / "paper.md", lambda file: file.write_text(text, encoding="utf-8"))
    console.print(f"\nwrote {output / 'paper.md'} and its figures", highlight=False)


def _sections(
    scratch: Path, output: Path, scene: Path | None, model: Path | None, truth: Path | None
) -> Iterator[Section]:
    yield _bins(scratch / "bins", output)
    yield _from_above(scratch / "above")
    yield _noise(scratch / "noise", output)
    if scene is None or model is None or truth is None:
        yield _artificial_residuals(scratch / "residuals", output)
    else:
        yield _residuals_of(scratch / "own", output, scene, model, truth)


def _bins(scratch: Path, output: Path) -> Section:
    experiment = ArtificialExperiment(scratch, noise_scene(0.0))
    one, two = experiment.models("model_1"), experiment.models("model_1", "model_2")
    rows = [
        [
            f"the paper's recipe, rho {bin_m} m",
            expected,
            *_numbers(experiment.candidates(one, bin_m)),
        ]
        for bin_m, expected in zip(BINS_M, ("4 + 0", "4 + 4"), strict=True)
    ]
    alone, both = experiment.detections(one), experiment.detections(two)
    rows.append(["spinpipe, model 1", "", *_numbers(alone)])
    rows.append(["spinpipe, both models", "", *_numbers(both)])
    evaluation = evaluate_run(RunFolder(scratch / "run"), scratch / "truth.csv")
    write_picture(evaluation, experiment.read, output / "paper_scene.png")
    return Section(
        title="3.1 Two bin sizes",
        paper="with model 1 and rho 0.1 m the four cars of model 1 are found and no others, with "
        "rho 0.2 m all eight cars.",
        here="candidates of the recipe; what spinpipe accepts after verification. With both "
        f"models {both.right_type} of {2 * CARS} cars got the right type"
        f"{_worst_errors(evaluation.accepted.matches)}.",
        header=("setting", "paper: model 1 + 2", "model 1", "model 2", "false", "hits"),
        rows=rows,
        figures=[("paper_scene.png", "The scene from above with what spinpipe found")],
    )


def _worst_errors(matches: Sequence[Match]) -> str:
    if not matches:
        return ""
    position_mm = 1000 * max(m.distance_m for m in matches)
    heading_deg = max(abs(m.heading_error_deg or 0.0) for m in matches)
    return f"; positions are at most {position_mm:.0f} mm off, headings {heading_deg:.1f} degrees"


def _numbers(found: Found) -> list[str]:
    return [str(n) for n in (found.of_model_1, found.of_model_2, found.false, found.hits)]


def _from_above(scratch: Path) -> Section:
    experiment = ArtificialExperiment(scratch, seen_from_above_scene())
    whole, above = experiment.models("model_1"), experiment.models_from_above("model_1")
    rows: list[list[str]] = []
    for bin_m in BINS_M:
        for name, models in (("whole model", whole), ("model from above", above)):
            found = experiment.candidates(models, bin_m)
            rows.append([f"recipe, rho {bin_m} m, {name}", *_numbers(found)])
    rows.append(["spinpipe, model from above", *_numbers(experiment.detections(above))])
    return Section(
        title="3.2 Seen from above",
        paper="single-view data is matched with a model sampled as it is seen from above.",
        here="upright walls and whatever something covers are missing from the scene, the car "
        "under the tent too: three cars of model 1 can be found.",
        header=("setting", "model 1", "model 2", "false", "hits"),
        rows=rows,
    )


def _noise(scratch: Path, output: Path) -> Section:
    fine: list[Found] = []
    coarse: list[Found] = []
    verified: list[Found] = []
    for noise_m in NOISE_M:
        experiment = ArtificialExperiment(scratch, noise_scene(noise_m))
        models = experiment.models("model_1")
        fine.append(experiment.candidates(models, BINS_M[0]))
        coarse.append(experiment.candidates(models, BINS_M[1]))
        verified.append(experiment.detections(models))
    names = (f"recipe, rho {BINS_M[0]} m", f"recipe, rho {BINS_M[1]} m", "spinpipe")
    series = (fine, coarse, verified)
    rows = [
        [f"{noise_m:.2f}", *(_noise_cell(s[i]) for s in series)]
        for i, noise_m in enumerate(NOISE_M)
    ]
    curves = [
        Curve(name, NOISE_M, [f.of_model_1 for f in found], colour)
        for colour, (name, found) in enumerate(zip(names, series, strict=True))
    ]
    false = [
        Curve(name, NOISE_M, [_false(f) for f in found], colour, dashed=True)
        for colour, (name, found) in enumerate(zip(names, series, strict=True))
    ]
    x_name = "standard deviation of the noise, m"
    draw_chart(
        Chart("Cars of model 1 found", x_name, "cars", curves, level=(CARS, "all")),
        output / "paper_noise_found.png",
    )
    draw_chart(
        Chart(f"False ones (up to {LARGEST_SHOWN})", x_name, "false", false, y_most=LARGEST_SHOWN),
        output / "paper_noise_false.png",
    )
    return Section(
        title="3.3 Noise",
        paper="the number of cars found falls with the noise until nothing is found at a "
        "standard deviation of about 0.25 m.",
        here="model 1 is searched for; each cell is found + false, where the cars of model 2 "
        "count as false. All four and no false one: "
        + "; ".join(f"{name} {_holds(s)}" for name, s in zip(names, series, strict=True))
        + ".",
        header=("sigma, m", *names),
        rows=rows,
        figures=[
            ("paper_noise_found.png", "Cars of model 1 found against noise"),
            ("paper_noise_false.png", "False ones against noise"),
        ],
    )


def _holds(series: Sequence[Found]) -> str:
    """Up to which noise all cars and nothing else are found."""
    perfect = [found.of_model_1 == CARS and not _false(found) for found in series]
    first_bad = perfect.index(False) if False in perfect else len(perfect)
    return f"up to {NOISE_M[first_bad - 1]:g} m" if first_bad else "never"


def _false(found: Found) -> int:
    return found.of_model_2 + found.false


def _noise_cell(found: Found) -> str:
    return f"{found.of_model_1} + {_false(found)}"


def _artificial_residuals(scratch: Path, output: Path) -> Section:
    experiment = ArtificialExperiment(scratch, noise_scene(0.0))
    models = experiment.models("model_1")
    read = run_scene(
        scratch, scratch / "scene.ply", models, paper_settings(ARTIFICIAL_BIN_M), "cluster"
    )
    labels = [t for t in labels_of(read, scratch / "truth.csv") if t.model == "model_1"]
    measured = list(residuals(read, labels, SAMPLES))
    where = (
        "no scene was given, so the artificial one stands in for the balcony: candidates of rho "
        f"{ARTIFICIAL_BIN_M} m, right those that end on a car of model 1"
    )
    return _residual_section(measured, where, output)


def _residuals_of(scratch: Path, output: Path, scene: Path, model: Path, truth: Path) -> Section:
    scratch.mkdir(parents=True)
    read = run_scene(scratch, scene, [("object", model, "above")], [], "cluster")
    measured = list(residuals(read, labels_of(read, truth), SAMPLES))
    where = (
        f"{scene.parent.name}/{scene.name} stands in for the balcony: the {MAX_CANDIDATES} best "
        "candidates of spinpipe's scan, right those that end on a labelled object"
    )
    return _residual_section(measured, where, output)


def _residual_section(measured: Sequence[Residuals], where: str, output: Path) -> Section:
    rows = [
        [
            str(r.samples),
            str(len(r.right_m)),
            *(_millimetres(r.right_m, level) for level in (50, 100)),
            str(len(r.wrong_m)),
            *(_millimetres(r.wrong_m, level) for level in (0, 50)),
            f"{r.separation:.3f}" if len(r.right_m) and len(r.wrong_m) else "-",
            f"{r.seconds:.1f}",
        ]
        for r in measured
    ]
    curves = [
        curve
        for colour, r in enumerate(measured)
        for curve in (
            _ranked(f"n = {r.samples}", r.right_m, colour, dashed=False),
            _ranked("", r.wrong_m, colour, dashed=True),
        )
        if curve.x
    ]
    if curves:
        title = "Residuals of the right candidates (filled) and of the wrong ones (hollow)"
        chart = Chart(title, "rank", "RMS, mm", curves)
        draw_chart(chart, output / "paper_residuals.png")
    return Section(
        title="3.4 Residuals",
        paper="13 cars on a balcony scene of about 1000 points per square metre: 18 candidates, "
        "12 right; 115 mm parts good fits from bad ones, and 500 samples suffice.",
        here=f"{where}. RMS distances in mm of the best of 12 starts after 15 iterations, 80 % of "
        "the pairs; separation is how often a right one has the smaller residual: 1 is perfect, "
        "0.5 is chance.",
        header=(
            *("n", "right", "median", "largest", "wrong", "smallest", "median"),
            *("separation", "seconds"),
        ),
        rows=rows,
        figures=[("paper_residuals.png", "Residuals of all candidates")] if curves else [],
    )


def _ranked(name: str, rms_m: np.ndarray, colour: int, *, dashed: bool) -> Curve:
    places = [i + 1.0 for i in range(len(rms_m))]
    return Curve(name, places, [1000.0 * v for v in rms_m.tolist()], colour, dashed)


def _millimetres(rms_m: np.ndarray, level: float) -> str:
    return f"{1000 * float(np.percentile(rms_m, level)):.0f}" if len(rms_m) else "-"
