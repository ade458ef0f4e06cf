"""``avrare monitor``: evaluate a specification on a recorded drive: is it violated, when, by whom and why."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.analysis.monitor.monitoring import monitor_recording
from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import ExitCode, UsageError, did_you_mean
from avrare.cli import monitor_batch
from avrare.cli.options import LANE_WIDTH
from avrare.cli.output import can_draw, print_warnings, write_files
from avrare.logic import stl
from avrare.logic.formula import find_formula
from avrare.logic.syntax import nodes
from avrare.protocols import find_scene
from avrare.report.documents.monitoring_documents import monitoring_document, write_monitoring_csv
from avrare.report.plots import monitoring_plot
from avrare.report.terminal.console import make_console
from avrare.report.terminal.monitoring_text import draw_chart, headline
from avrare.results.recordings.commonroad import read_commonroad
from avrare.results.recordings.csv_recording import read_csv
from avrare.results.recordings.drives import open_drives
from avrare.results.recordings.drone_recording import is_drone_recording
from avrare.results.recordings.recording import parse_road
from avrare.results.recordings.replayed_failure import replay_run_failure
from avrare.results.run import Run
from avrare.scenario.load import load
from avrare.stack.builder import build_block, build_formula, build_rule, build_specification


def execute(args: argparse.Namespace) -> int:
    """Score the recording and print the outcome; return exit code 1 if the specification is violated."""
    batch = monitor_batch.is_batch(args)
    _check(args, batch)
    if batch:
        return monitor_batch.execute(args, _scenario_and_road(args)[1])
    if Path(args.file).is_dir():
        name, specification, recording = _case_of_run(args)
    else:
        scenario, road = _scenario_and_road(args)
        recording = _read(args, road)
        name, specification = _specification(args, recording, scenario)
    warnings = _warnings(args, specification, recording)
    print_warnings((warning.message, warning.hint) for warning in warnings)
    print_warnings(
        (text, "the verdict is of what was recorded") for text in _clipped(specification, recording)
    )
    scored = monitor_recording(name, specification, recording)
    if args.out is not None:
        _write(scored, Path(args.out))
    if args.json:
        print(json.dumps(monitoring_document(scored)))
    else:
        _show(scored, args.out)
    return int(ExitCode.FAIL if scored.violated else ExitCode.PASS)


def _check(args: argparse.Namespace, batch: bool) -> None:
    chosen = [f"--{name}" for name in ("rule", "stl", "specification") if getattr(args, name) is not None]
    if args.jobs != 1 and not batch:
        raise UsageError("--jobs is for a folder of recordings, or for --ego all")
    if Path(args.file).is_dir() and not batch:
        names = ("ego", "scenario", "lanes", "lane_width", "access_ramp", "broad_marking", "network")
        if wrong := [name.replace("_", "-") for name in names if getattr(args, name) is not None]:
            text = f"--{wrong[0]} cannot be used with a run folder"
            raise UsageError(text, "the road and the ego are those of its scenario")
        chosen = [name for name in chosen if name != "--specification"]
    elif not chosen:
        raise UsageError("no specification given", "give --rule NAME, --stl FORMULA or --specification NAME")
    if args.failure is not None and (batch or not Path(args.file).is_dir()):
        raise UsageError("--failure requires a run folder as FILE")
    if len(chosen) > 1:
        raise UsageError(f"{' and '.join(chosen)} cannot be combined", "give one of them")
    if args.set and args.rule is None and args.stl is None:
        raise UsageError("--set requires --rule or --stl", "it sets options of the rule")
    if args.specification is not None and not Path(args.file).is_dir() and args.scenario is None:
        raise UsageError("--specification requires --scenario", "give --scenario FILE")


def _case_of_run(args: argparse.Namespace) -> tuple[str, Any, Any]:
    run = Run.read(args.file)
    found = replay_run_failure(run, args.specification, args.failure, args.rule)
    print_warnings((line, None) for line in (*run.changes, *found.changes))
    if args.rule is None and args.stl is None:
        return found.specification, run.problem.monitor(found.specification), found.recording
    return *_specification(args, found.recording, None), found.recording


def _scenario_and_road(args: argparse.Namespace) -> tuple[Any, Any]:
    scenario = road = None
    if args.scenario is not None:
        scenario = load(args.scenario)
        scene = find_scene(build_block(scenario.simulator, None))
        road = scene.road if scene is not None else None
    if args.lanes is not None:
        width = LANE_WIDTH if args.lane_width is None else args.lane_width
        return scenario, parse_road(args.lanes, width, args.access_ramp, args.broad_marking)
    if not args.lane_width is args.access_ramp is args.broad_marking is None:
        text = "--lane-width, --access-ramp and --broad-marking require --lanes"
        raise UsageError(text, "give --lanes Y,...")
    return scenario, road


def _read(args: argparse.Namespace, road: Any) -> Any:
    if args.file.lower().endswith(".xml"):
        return read_commonroad(args.file, args.ego, road)
    if is_drone_recording(Path(args.file)) or args.network is not None:
        if args.ego is None:
            raise UsageError(f"{args.file}: no ego is chosen", "choose it by its id with --ego, or --ego all")
        return open_drives(args.file, road, args.network).recording(args.ego)
    return read_csv(args.file, "ego" if args.ego is None else args.ego, road)


def _specification(args: argparse.Namespace, recording: Any, scenario: Any) -> tuple[str, Any]:
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
    if args.stl is not None:
        return stl(args.stl, dt=recording.dt, warn=False).warnings
    formula = find_formula(specification)
    return formula.warnings if formula is not None else ()


def _clipped(specification: Any, recording: Any) -> list[str]:
    formula = find_formula(specification)
    span = nodes.bounded_span(formula.node) if formula is not None else 0
    if span < recording.samples:
        return []
    text = f"the formula looks {span} samples ahead, and the recording has only {recording.samples}"
    return [f"{text}: windows are clipped at its end"]


def _missing_scene(recording: Any, what: str) -> UsageError:
    if "ego_x" in recording.signals:
        hint = "give --scenario FILE, or --lanes with the lane centres from right to left"
        return UsageError(f"{recording.source}: {what} a road", hint)
    hint = "give a file with the columns time, vehicle, x, y, ...; or score signals with --stl"
    return UsageError(f"{recording.source}: {what} vehicles, not named signals", hint)


def _write(scored: Any, folder: Path) -> None:
    write_files(folder, {"monitor.json": json.dumps(monitoring_document(scored)) + "\n"})
    with explain_file_errors(f"{folder}: cannot write", "choose another --out"):
        write_monitoring_csv(scored, folder / "monitor.csv")
        if can_draw():
            monitoring_plot.draw(scored, folder / "monitor.png")


def _show(scored: Any, out: str | None) -> None:
    console = make_console()
    for line in [*headline(scored), *([] if scored.no_vehicles else ["", *draw_chart(scored)])]:
        console.print(line)
    if out:
        console.print(f"\nwritten to {out}", markup=False)
