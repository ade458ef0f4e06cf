"""``avrare monitor``: does a recorded drive keep a rule, and if not, when, with whom and why?"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from avrare.cli.doubts import warn
from avrare.errors import ExitCode, UsageError

_LANE_WIDTH = 3.5

_EXAMPLE = """\
FILE is one of
  a CSV file of named signals: a column 'time' and one for each signal
  a CSV file of vehicles, a row for each vehicle and time: time, vehicle, x, y,
      heading, speed, length, width and, if known, acceleration
  a CommonRoad XML file
  the folder of a run, whose stored failures are driven again

examples:
  avrare monitor gaps.csv --stl "always (gap > 2)"
  avrare monitor drive.csv --rule R_G1 --lanes -1.75,1.75,5.25 --access-ramp 0
  avrare monitor runs/lane_change --specification safe_distance --failure 0

exit code: 0 kept, 1 broken, 4 bad file or usage, 5 a package or plugin is missing
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.epilog = _EXAMPLE
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    # A list of lanes begins with a minus and is no option: -1.75,1.75,5.25.
    parser._negative_number_matcher = re.compile(r"-\.?\d")
    parser.add_argument("file", metavar="FILE", help="recorded drive, or the folder of a run")
    what = parser.add_argument_group("what to score")
    what.add_argument("--rule", metavar="NAME", help="a rule of a plugin; 'avrare rules' lists them")
    what.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="an option of the rule")
    what.add_argument("--stl", metavar="FORMULA", help="a formula over signals, or over vehicles")
    what.add_argument("--specification", metavar="NAME", help="one of the scenario's, or of the run's")
    where = parser.add_argument_group("the recording")
    where.add_argument("--ego", metavar="NAME", help="the vehicle that rules are for; in CSV files 'ego'")
    where.add_argument("--scenario", metavar="FILE", help="take the road of this scenario's simulator")
    where.add_argument("--lanes", metavar="Y,...", help="lane centres from right to left [m]")
    where.add_argument(
        "--lane-width", type=float, metavar="W", help=f"of every lane [m]; default {_LANE_WIDTH}"
    )
    where.add_argument("--access-ramp", metavar="I,...", help="which lanes are an access ramp, from 0")
    where.add_argument("--failure", type=int, metavar="K", help="of a run: which failure; default: the worst")
    parser.add_argument("--out", metavar="DIR", help="write monitor.csv, monitor.json and a picture")
    parser.add_argument("--json", action="store_true", help="print the whole series as JSON")


def execute(args: argparse.Namespace) -> int:
    """Score the recording, say what happened, and exit with 1 if the rule is broken."""
    from avrare.record.trace_score import score
    from avrare.report.monitoring import to_dict

    _check(args)
    name, specification, recording = _case(args)
    warn((found.message, found.hint) for found in _doubts(args, specification, recording))
    scored = score(name, specification, recording)
    if args.out is not None:
        _write(scored, Path(args.out))
    if args.json:
        print(json.dumps(to_dict(scored)))
    else:
        _show(scored, args.out)
    return int(ExitCode.FAIL if scored.broken else ExitCode.PASS)


def _case(args: argparse.Namespace) -> tuple[str, Any, Any]:
    """Name and monitor of the specification, and the recording."""
    if Path(args.file).is_dir():
        return _of_run(args)
    scenario, road = _surroundings(args)
    recording = _read(args, road)
    return *_specification(args, recording, scenario), recording


def _check(args: argparse.Namespace) -> None:
    chosen = [f"--{name}" for name in ("rule", "stl", "specification") if getattr(args, name) is not None]
    if Path(args.file).is_dir():
        names = ("ego", "scenario", "lanes", "lane_width", "access_ramp")
        if wrong := [name for name in names if getattr(args, name) is not None]:
            option = wrong[0].replace("_", "-")
            raise UsageError(f"--{option} does not fit the folder of a run", "its own scenario says all that")
        chosen = [name for name in chosen if name != "--specification"]
    elif not chosen:
        raise UsageError("nothing to score", "give --rule NAME, --stl FORMULA or --specification NAME")
    elif args.failure is not None:
        raise UsageError("--failure is for the folder of a run")
    if len(chosen) > 1:
        raise UsageError(f"{' and '.join(chosen)} together", "score one after the other")
    if args.out == "":
        raise UsageError("--out should be a folder, not ''")
    if args.set and args.rule is None and args.stl is None:
        raise UsageError("--set gives options of a rule", "give --rule NAME too")
    if args.specification is not None and not Path(args.file).is_dir() and args.scenario is None:
        raise UsageError("--specification names one of a scenario", "give --scenario FILE too")


def _of_run(args: argparse.Namespace) -> tuple[str, Any, Any]:
    from avrare.record.trace_run import replay

    found = replay(Path(args.file), args.specification, args.failure, args.rule)
    warn((line, None) for line in found.differing)
    if args.rule is None and args.stl is None:
        specification = found.scenario.stack.specifications[found.specification]
        return found.specification, specification, found.recording
    return *_specification(args, found.recording, None), found.recording


def _surroundings(args: argparse.Namespace) -> tuple[Any, Any]:
    """The scenario, if one is named, and the road, if anything tells it."""
    from avrare.record.trace_lanes import parse_road

    scenario = road = None
    if args.scenario is not None:
        from avrare.build.stack import build_block
        from avrare.scenario.load import load

        scenario = load(args.scenario)
        scene = getattr(build_block(scenario.simulator, None), "scene", None)
        road = scene.road if scene is not None else None
    if args.lanes is not None:
        width = _LANE_WIDTH if args.lane_width is None else args.lane_width
        return scenario, parse_road(args.lanes, width, args.access_ramp)
    if args.lane_width is not None or args.access_ramp is not None:
        raise UsageError("--lane-width and --access-ramp describe --lanes", "give --lanes too")
    return scenario, road


def _read(args: argparse.Namespace, road: Any) -> Any:
    if args.file.lower().endswith(".xml"):
        from avrare.record.trace_commonroad import read_commonroad

        return read_commonroad(args.file, args.ego, road)
    from avrare.record.trace_csv import read_csv

    return read_csv(args.file, "ego" if args.ego is None else args.ego, road)


def _specification(args: argparse.Namespace, recording: Any, scenario: Any) -> tuple[str, Any]:
    from avrare.build.rules import build_rule
    from avrare.build.stack import build_specification
    from avrare.errors import did_you_mean

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
    """The monitor of ``--stl``; predicates of vehicles are a plugin's."""
    from avrare.build.rules import build_formula
    from avrare.logic import formula as f
    from avrare.logic import stl

    formula = stl(args.stl, dt=recording.dt, warn=False)
    relations = any(isinstance(part, f.Signal) and part.arguments for part in f.walk(formula.node))
    if relations and recording.scene is not None:
        return build_formula(args.stl, args.set, recording.scene)
    if args.set:
        raise UsageError("--set gives options of a rule", "a formula over signals has none")
    if relations and not set(formula.signals) <= set(recording.signals):
        raise _missing_scene(recording, "predicates of vehicles need")
    return formula.monitor()


def _doubts(args: argparse.Namespace, specification: Any, recording: Any) -> Sequence[Any]:
    """What looks odd in the formula: as the user wrote it, not as a plugin completes it."""
    from avrare.logic import stl

    if args.stl is not None:
        return stl(args.stl, dt=recording.dt, warn=False).warnings
    return getattr(getattr(specification, "formula", None), "warnings", ())


def _missing_scene(recording: Any, what: str) -> UsageError:
    """Why what is said of vehicles cannot be scored."""
    if "ego_x" in recording.signals:
        hint = "give --scenario FILE, or --lanes with the lane centres from right to left"
        return UsageError(f"{recording.source}: {what} a road", hint)
    hint = "give a file with the columns time, vehicle, x, y, ...; or score signals with --stl"
    return UsageError(f"{recording.source}: {what} vehicles, not named signals", hint)


def _write(scored: Any, folder: Path) -> None:
    from avrare.record.whole import write_text
    from avrare.report import picture, trace_picture
    from avrare.report.monitoring import to_dict, write_series

    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_series(scored, folder / "monitor.csv")
        write_text(folder / "monitor.json", json.dumps(to_dict(scored)) + "\n")
        if picture.available():
            trace_picture.draw(scored, folder / "monitor.png")
        else:
            print("no picture: matplotlib is not installed; pip install 'avrare[plot]'", file=sys.stderr)
    except OSError as error:
        text = f"{folder}: cannot write: {error.strerror or error}"
        raise UsageError(text, "choose another --out") from error


def _show(scored: Any, out: str | None) -> None:
    from rich.console import Console

    from avrare.report.monitoring import chart, headline

    console = Console(soft_wrap=True, highlight=False)
    for line in [*headline(scored), *([] if scored.nobody else ["", *chart(scored)])]:
        console.print(line)
    if out:
        console.print(f"\nwritten to {out}", markup=False)
