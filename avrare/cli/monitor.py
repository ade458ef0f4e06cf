"""``avrare monitor``: evaluate a specification on a recorded drive: is it violated, when, by whom and why."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.base.errors import ExitCode, UsageError, did_you_mean
from avrare.cli.output import can_draw, print_warnings, write_errors, write_files
from avrare.cli.parser import add_set_argument, set_epilog
from avrare.protocols import find_scene

_LANE_WIDTH = 3.5

_EPILOG = """\
FILE is one of
  a CSV file of signals: a column 'time' and one column per signal
  a CSV file of vehicles, one row per vehicle and time: time, vehicle, x, y,
      heading, speed, length, width and, optionally, acceleration
  a CommonRoad XML file
  a run folder, whose stored failures are replayed

examples:
  avrare monitor gaps.csv --stl "always (gap > 2)"
  avrare monitor drive.csv --rule R_G1 --lanes -1.75,1.75,5.25 --access-ramp 0
  avrare monitor runs/lane_change --specification safe_distance --failure 0

exit code: 0 satisfied, 1 violated, 4 bad file or usage, 5 a package or plugin is missing
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    set_epilog(parser, _EPILOG)
    # A list of lanes such as -1.75,1.75,5.25 begins with a minus but is not an option.
    parser._negative_number_matcher = re.compile(r"-\.?\d")
    parser.add_argument("file", metavar="FILE", help="recorded drive, or run folder")
    rule = parser.add_argument_group("specification")
    rule.add_argument("--rule", metavar="NAME", help="traffic rule of a plugin; 'avrare rules' lists them")
    add_set_argument(rule, "set an option of the rule; may be repeated")
    rule.add_argument("--stl", metavar="FORMULA", help="formula over signals or vehicles")
    rule.add_argument("--specification", metavar="NAME", help="specification of the scenario or of the run")
    recording = parser.add_argument_group("recording")
    recording.add_argument("--ego", metavar="NAME", help="vehicle under test (default in CSV files: ego)")
    recording.add_argument("--scenario", metavar="FILE", help="scenario whose simulator provides the road")
    recording.add_argument("--lanes", metavar="Y,...", help="lane centres from right to left [m]")
    recording.add_argument(
        "--lane-width", type=float, metavar="W", help=f"lane width [m] (default {_LANE_WIDTH})"
    )
    recording.add_argument("--access-ramp", metavar="I,...", help="indices of access ramp lanes, from 0")
    recording.add_argument(
        "--failure", type=int, metavar="K", help="index of a run's failure (default: the worst)"
    )
    parser.add_argument("--out", metavar="DIR", help="write monitor.csv, monitor.json and monitor.png")
    parser.add_argument("--json", action="store_true", help="print the result with all samples as JSON")


def execute(args: argparse.Namespace) -> int:
    """Score the recording and print the outcome; return exit code 1 if the specification is violated."""
    from avrare.analysis.monitor.monitoring import monitor_recording
    from avrare.report.documents.monitoring_documents import monitoring_document

    _check(args)
    if Path(args.file).is_dir():
        name, specification, recording = _case_of_run(args)
    else:
        scenario, road = _scenario_and_road(args)
        recording = _read(args, road)
        name, specification = _specification(args, recording, scenario)
    warnings = _warnings(args, specification, recording)
    print_warnings((warning.message, warning.hint) for warning in warnings)
    scored = monitor_recording(name, specification, recording)
    if args.out is not None:
        _write(scored, Path(args.out))
    if args.json:
        print(json.dumps(monitoring_document(scored)))
    else:
        _show(scored, args.out)
    return int(ExitCode.FAIL if scored.violated else ExitCode.PASS)


def _check(args: argparse.Namespace) -> None:
    chosen = [f"--{name}" for name in ("rule", "stl", "specification") if getattr(args, name) is not None]
    if Path(args.file).is_dir():
        names = ("ego", "scenario", "lanes", "lane_width", "access_ramp")
        if wrong := [name.replace("_", "-") for name in names if getattr(args, name) is not None]:
            text = f"--{wrong[0]} cannot be used with a run folder"
            raise UsageError(text, "the road and the ego are those of its scenario")
        chosen = [name for name in chosen if name != "--specification"]
    elif not chosen:
        raise UsageError("no specification given", "give --rule NAME, --stl FORMULA or --specification NAME")
    elif args.failure is not None:
        raise UsageError("--failure requires a run folder as FILE")
    if len(chosen) > 1:
        raise UsageError(f"{' and '.join(chosen)} cannot be combined", "give one of them")
    if args.out == "":
        raise UsageError("--out must be a folder, not ''")
    if args.set and args.rule is None and args.stl is None:
        raise UsageError("--set requires --rule or --stl", "it sets options of the rule")
    if args.specification is not None and not Path(args.file).is_dir() and args.scenario is None:
        raise UsageError("--specification requires --scenario", "give --scenario FILE")


def _case_of_run(args: argparse.Namespace) -> tuple[str, Any, Any]:
    from avrare.results.recordings.replayed_failure import replay_run_failure

    found = replay_run_failure(Path(args.file), args.specification, args.failure, args.rule)
    print_warnings((line, None) for line in found.changes)
    if args.rule is None and args.stl is None:
        specification = found.scenario.stack.specifications[found.specification]
        return found.specification, specification, found.recording
    return *_specification(args, found.recording, None), found.recording


def _scenario_and_road(args: argparse.Namespace) -> tuple[Any, Any]:
    from avrare.results.recordings.lanes import parse_road

    scenario = road = None
    if args.scenario is not None:
        from avrare.scenario.load import load
        from avrare.stack.builder import build_block

        scenario = load(args.scenario)
        scene = find_scene(build_block(scenario.simulator, None))
        road = scene.road if scene is not None else None
    if args.lanes is not None:
        width = _LANE_WIDTH if args.lane_width is None else args.lane_width
        return scenario, parse_road(args.lanes, width, args.access_ramp)
    if args.lane_width is not None or args.access_ramp is not None:
        raise UsageError("--lane-width and --access-ramp require --lanes", "give --lanes Y,...")
    return scenario, road


def _read(args: argparse.Namespace, road: Any) -> Any:
    if args.file.lower().endswith(".xml"):
        from avrare.results.recordings.commonroad import read_commonroad

        return read_commonroad(args.file, args.ego, road)
    from avrare.results.recordings.csv_recording import read_csv

    return read_csv(args.file, "ego" if args.ego is None else args.ego, road)


def _specification(args: argparse.Namespace, recording: Any, scenario: Any) -> tuple[str, Any]:
    from avrare.stack.builder import build_rule, build_specification

    if args.stl is not None:
        return "formula", _formula(args, recording)
    if args.rule is not None:
        if recording.scene is None:
            raise _missing_scene(recording, "a rule needs")
        return args.rule, build_rule(args.rule, args.set, recording.scene)
    part = scenario.specifications.get(args.specification)
    if part is None:
        near = did_you_mean(args.specification, scenario.specifications)
        raise UsageError(f"{args.scenario}: there is no specification {args.specification!r}", near)
    return args.specification, build_specification(part, recording.scene, recording.dt)


def _formula(args: argparse.Namespace, recording: Any) -> Any:
    from avrare.logic import stl
    from avrare.logic.syntax import nodes
    from avrare.stack.builder import build_formula

    formula = stl(args.stl, dt=recording.dt, warn=False)
    relations = any(isinstance(part, nodes.Signal) and part.arguments for part in nodes.walk(formula.node))
    if relations and recording.scene is not None:
        return build_formula(args.stl, args.set, recording.scene)
    if args.set:
        raise UsageError("--set cannot be used with a formula over signals", "it has no options")
    if relations and not set(formula.signals) <= set(recording.signals):
        raise _missing_scene(recording, "predicates of vehicles need")
    return formula.monitor()


def _warnings(args: argparse.Namespace, specification: Any, recording: Any) -> Sequence[Any]:
    from avrare.logic import stl
    from avrare.logic.formula import find_formula

    if args.stl is not None:
        return stl(args.stl, dt=recording.dt, warn=False).warnings
    formula = find_formula(specification)
    return formula.warnings if formula is not None else ()


def _missing_scene(recording: Any, what: str) -> UsageError:
    if "ego_x" in recording.signals:
        hint = "give --scenario FILE, or --lanes with the lane centres from right to left"
        return UsageError(f"{recording.source}: {what} a road", hint)
    hint = "give a file with the columns time, vehicle, x, y, ...; or score signals with --stl"
    return UsageError(f"{recording.source}: {what} vehicles, not named signals", hint)


def _write(scored: Any, folder: Path) -> None:
    from avrare.report.documents.monitoring_documents import monitoring_document, write_monitoring_csv
    from avrare.report.plots import monitoring_plot

    write_files(folder, {"monitor.json": json.dumps(monitoring_document(scored)) + "\n"})
    with write_errors(folder, "choose another --out"):
        write_monitoring_csv(scored, folder / "monitor.csv")
        if can_draw():
            monitoring_plot.draw(scored, folder / "monitor.png")


def _show(scored: Any, out: str | None) -> None:
    from rich.console import Console

    from avrare.report.terminal.monitoring_text import draw_chart, headline

    console = Console(soft_wrap=True, highlight=False)
    for line in [*headline(scored), *([] if scored.no_vehicles else ["", *draw_chart(scored)])]:
        console.print(line)
    if out:
        console.print(f"\nwritten to {out}", markup=False)
