"""Recognition on scenes that nothing was tuned on: other objects, other samplings, other units.

    uv run python tests/bench/recognition.py                        # artificial scenes
    uv run python tests/bench/recognition.py --quick --details
    uv run python tests/bench/recognition.py --data DIR             # and real ones, perturbed

Artificial scenes (``recognition_scenes.py``) hold eight instances of an object among decoys; the
pipeline gets the scene and the model and keeps its defaults. DIR holds NAME/scene.ply and
NAME/truth.csv of car parks, which are run with recordings/carpark.toml.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from recognition_judge import Trial
from recognition_objects import SOUGHT
from recognition_real import real_trials
from recognition_report import print_details, print_reliability, print_table
from recognition_scenes import CONDITIONS
from recognition_trial import artificial_trial

QUICK_OBJECTS = ("chair", "table", "barrel", "lathe", "saloon")
QUICK_CONDITIONS = ("base", "drone", "skin")


def main() -> None:
    """Run the trials and print the tables."""
    options = _options()
    trials: list[Trial] = []
    if not options.only_data:
        for sought in SOUGHT:
            if options.objects and sought.name not in options.objects:
                continue
            if options.quick and not options.objects and sought.name not in QUICK_OBJECTS:
                continue
            for condition in CONDITIONS:
                if options.quick and condition.name not in QUICK_CONDITIONS:
                    continue
                if options.conditions and condition.name not in options.conditions:
                    continue
                for seed in options.seed:
                    trial = artificial_trial(
                        sought, condition, seed, options.threads, options.extra, options.keep
                    )
                    trials.append(trial)
                    _say(trial)
    _report("artificial scenes", trials, options.details)
    real: list[Trial] = []
    if options.data:
        with tempfile.TemporaryDirectory() as temporary:
            work = options.keep or Path(temporary)
            for trial in real_trials(
                options.data, options.threads, options.seed[0], work, options.quick
            ):
                real.append(trial)
                _say(trial)
    _report("real scenes", real, options.details)
    if options.json:
        document = {"trials": [t.document() for t in trials + real]}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _say(trial: Trial) -> None:
    print(
        f"# {trial.sought}/{trial.condition}: {trial.found} of {trial.instances}, "
        f"{trial.false} false, {trial.points} points, {trial.candidates} candidates, "
        f"{trial.seconds:.1f} s {trial.error}",
        flush=True,
    )


def _report(title: str, trials: list[Trial], details: bool) -> None:
    if not trials:
        return
    print(f"\n{title}\n")
    print_table(trials)
    print_reliability(trials)
    if details:
        print_details(trials)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, nargs="+", default=[0], help="one scene for each")
    parser.add_argument("--quick", action="store_true", help="a subset")
    parser.add_argument("--objects", nargs="+", choices=[s.name for s in SOUGHT])
    parser.add_argument("--conditions", nargs="+", choices=[c.name for c in CONDITIONS])
    parser.add_argument("--data", type=Path, help="folder with NAME/scene.ply and NAME/truth.csv")
    parser.add_argument("--only-data", action="store_true", help="no artificial scenes")
    parser.add_argument("--extra", default="", help="more lines of the config, after the model's")
    parser.add_argument("--threads", type=int, default=0, help="0: all cores")
    parser.add_argument("--json", type=Path, help="write every number here")
    parser.add_argument("--details", action="store_true", help="every miss and false detection")
    parser.add_argument("--keep", type=Path, help="keep scenes and runs in this folder")
    return parser.parse_args()


if __name__ == "__main__":
    main()
