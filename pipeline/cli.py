"""The command line. Heavy imports wait inside the commands: ``spinpipe --help`` answers at once."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from spinpipe.pipeline.cli_options import (
    ConfigArgument,
    ExportFormat,
    ForceOption,
    Frame,
    FromOption,
    OutputOption,
    RerunMode,
    RerunOption,
    Role,
    RunArgument,
    SetOption,
    UntilOption,
)

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: to load rich takes longer than all the rest
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Find every instance of a known object in a point cloud reconstructed from photos.",
)


@app.command()
def run(
    config: ConfigArgument,
    output: OutputOption = None,
    overrides: SetOption = None,
    start: FromOption = None,
    until: UntilOption = None,
    rerun: RerunOption = RerunMode.save,
    force: ForceOption = False,
) -> None:
    """Run a config; what did not change since the last run is reused.

    Ends with 0 even if nothing was found (that is a result), with 1 if the input cannot be
    worked on, with 2 if the config or the command is wrong, with 129, 130 or 143 after a signal.
    """
    from spinpipe.pipeline.commands import run_command

    run_command(config, output, overrides or [], start, until, rerun.value, force)


@app.command()
def plan(
    config: ConfigArgument,
    output: OutputOption = None,
    overrides: SetOption = None,
    start: FromOption = None,
    until: UntilOption = None,
) -> None:
    """Say what a run would do and why, without doing it."""
    from spinpipe.pipeline.commands import plan_command

    plan_command(config, output, overrides or [], start, until)


@app.command()
def inspect(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Scenes and models.")],
    role: Annotated[
        Role | None,
        typer.Option("--as", help="What they are; by default a mesh is a model, all else a scene."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Say what files hold and how a run would understand them: size, unit, up, and why.

    Ends with 1 if a run would refuse one of them.
    """
    from spinpipe.pipeline.commands import inspect_command

    inspect_command(files, role.value if role else "", json)


@app.command()
def init(
    path: Annotated[Path, typer.Argument(metavar="[CONFIG]")] = Path("config.toml"),
    scene: Annotated[str, typer.Option(help="The reconstruction.")] = "",
    model: Annotated[
        list[str] | None, typer.Option(help="What to find: a mesh or a cloud; repeatable.")
    ] = None,
    shape: Annotated[
        list[str] | None, typer.Option(help="Instead a shape that ships, saloon; repeatable.")
    ] = None,
    preset: Annotated[str, typer.Option(help="A config that ships: carpark.")] = "",
    overrides: SetOption = None,
    force: ForceOption = False,
) -> None:
    """Look at a scene and models and write a commented config; without a scene, an example.

    Keys that the files tell are filled in; what a run would refuse is refused.
    """
    from spinpipe.pipeline.commands import init_command

    init_command(path, scene, model or [], shape or [], preset, overrides or [], force)


@app.command()
def demo(
    output: OutputOption = None,
    noise: Annotated[float, typer.Option(min=0.0, max=5.0, help="Gaussian noise, metres.")] = 0.0,
    start: FromOption = None,
    rerun: RerunOption = RerunMode.save,
    force: ForceOption = False,
) -> None:
    """Make the paper's artificial scene and run the pipeline on it."""
    from spinpipe.pipeline.commands import demo_command

    demo_command(output, noise, start, rerun.value, force)


@app.command()
def stages() -> None:
    """Explain the stages: their topics and every key of their sections."""
    from spinpipe.pipeline.commands import stages_command

    stages_command()


@app.command()
def record(
    folder: RunArgument,
    rerun: RerunOption = RerunMode.save,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Labels, see eval: found, missed and false coloured."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Draw a run's MCAP files into a Rerun recording, without running anything again."""
    from spinpipe.pipeline.commands import record_command

    record_command(folder, rerun.value, truth, force)


@app.command()
def status(
    folder: RunArgument,
) -> None:
    """Say what of a run is there, and whether it is being worked on."""
    from spinpipe.pipeline.results.status import status_command

    status_command(folder)


@app.command()
def why(
    folder: RunArgument,
    candidates: Annotated[
        list[int], typer.Argument(metavar="ID...", min=0, help="Ids of candidates.")
    ],
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw what is there: a .png, .jpg or .webp."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Tell the life of candidates, from their hits to what decided.

    Ids are in the report and in detections.json, those of accepted ones also on the map.
    """
    from spinpipe.pipeline.results.why import why_command

    why_command(folder, candidates, picture, force)


@app.command()
def view(
    folder: RunArgument,
    candidate: Annotated[
        int | None, typer.Option(metavar="ID", min=0, help="Go to this candidate.")
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="In a browser, also without display.")] = False,
) -> None:
    """Open a run's recording in the Rerun viewer."""
    from spinpipe.pipeline.results.view import view_command

    view_command(folder, candidate, web)


@app.command()
def diff(
    before: Annotated[Path, typer.Argument(metavar="A", help="A run's folder.")],
    after: Annotated[Path, typer.Argument(metavar="B", help="Another run in the same scene.")],
    recording: Annotated[
        Path | None, typer.Option("--record", metavar="RRD", help="Draw both into a recording.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Compare what two runs accepted: gained, lost, moved, of another type."""
    from spinpipe.pipeline.results.diff import diff_command

    diff_command(before, after, recording, force)


@app.command()
def export(
    folder: RunArgument,
    name: Annotated[ExportFormat, typer.Option("--format", "-f", help="What to write.")],
    fates: Annotated[
        str, typer.Option("--fate", metavar="FATE[,FATE]", help="Which candidates.")
    ] = "accepted",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="(RUN/export.<format>)")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Write what was found for another tool, one object an id.

    geojson: footprints in longitude and latitude. ply, obj: fitted models in scene coordinates.
    kitti: labels in a camera frame at the world's origin. las: the scene's points with object ids.
    mcap: the whole run for Foxglove (--fate all the fates that shall have boxes).
    """
    from spinpipe.pipeline.results.export import export_command

    export_command(folder, name.value, [fate.strip() for fate in fates.split(",")], output, force)


@app.command("eval")
def evaluate(
    folder: RunArgument,
    truth: Annotated[
        Path,
        typer.Option(
            metavar="CSV", help="Labels: x,y and optionally model,z,heading_deg,axis_deg,ignore."
        ),
    ],
    radius: Annotated[float, typer.Option(min=0.0, help="Farthest match, metres.")] = 1.5,
    by_model: Annotated[
        bool | None,
        typer.Option(
            "--by-model/--any-model",
            help="Whether models must agree; by default if the labels name one of the run's.",
        ),
    ] = None,
    frame: Annotated[Frame, typer.Option(help="Frame of the labels.")] = Frame.scene,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where to write it (RUN/eval.json).")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw the scene from above.")
    ] = None,
    force: ForceOption = False,
) -> None:
    """Compare a run with labels: recall, precision, errors and misses."""
    from spinpipe.pipeline.evaluation.evaluate import eval_command

    rule = None if by_model is None else "name" if by_model else "any"
    eval_command(folder, truth, radius, rule, frame.value, json, picture, force)


@app.command()
def plant(
    path: Annotated[
        Path, typer.Argument(metavar="CONFIG|RUN", help="A config, or the folder of its run.")
    ],
    count: Annotated[int, typer.Option(min=1, max=100_000, help="Objects to plant.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="Of where they stand.")] = 0,
    picture: Annotated[bool, typer.Option(help="Draw RUN/plant/plant.png.")] = True,
    rerun: RerunOption = RerunMode.off,
    force: ForceOption = False,
) -> None:
    """Plant the models into their scene and look: recall without labels."""
    from spinpipe.pipeline.evaluation.plant import plant_command

    plant_command(path, count, seed, picture, rerun.value, force)


@app.command()
def paper(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Where the report goes.")
    ] = Path("paper"),
    scene: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A real scene of cars for section 3.4 (artificial)."),
    ] = None,
    model: Annotated[Path | None, typer.Option(metavar="FILE", help="A car's mesh for it.")] = None,
    truth: Annotated[Path | None, typer.Option(metavar="CSV", help="Its labels.")] = None,
    force: ForceOption = False,
) -> None:
    """Repeat the paper's experiments; print its numbers beside ours."""
    from spinpipe.pipeline.evaluation.paper import paper_command

    paper_command(output, scene, model, truth, force)


model_app = typer.Typer(no_args_is_help=True, help="Make models of objects.")
app.add_typer(model_app, name="model")


@model_app.command("cut")
def model_cut(
    folder: RunArgument,
    at: Annotated[str, typer.Option(metavar="X,Y[,Z]", help="Its base centre, scene coordinates.")],
    size: Annotated[
        str, typer.Option(metavar="L,W,H", help="Length, width, height of the box, metres.")
    ],
    heading: Annotated[
        float, typer.Option(help="Where its front is, degrees from the scene's +x to +y.")
    ] = 0.0,
    name: Annotated[str, typer.Option(help="Name of the model.")] = "object",
    out: Annotated[Path, typer.Option(metavar="PLY", help="The file to write.")] = Path(
        "object.ply"
    ),
    force: ForceOption = False,
) -> None:
    """Cut one instance out of a run's scene, to look for more of its kind."""
    from spinpipe.pipeline.cut import cut_command

    cut_command(folder, at, size, heading, name, out, force)


def _print_version(value: bool) -> None:
    if value:
        from importlib.metadata import version

        typer.echo(f"spinpipe {version('spinpipe')}")
        raise typer.Exit


@app.callback()
def common(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print it."),
    ] = False,
) -> None:
    """Options of all commands."""


def main() -> None:
    """Run the command line; every error is one line on stderr and a non-zero exit code."""
    try:
        try:
            app()
        finally:
            sys.stdout.flush()  # here, where its errors are told
    except Exception as error:
        from spinpipe.pipeline.errors import describe

        text, code = describe(error)
        sys.stderr.write(f"spinpipe: {text}\n")
        sys.exit(code)
