"""``avrare monitor``: evaluate a specification on a recorded drive: is it violated, when, by whom and why."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import ExitCode, UsageError
from avrare.cli.options import (
    DISPLAY,
    REPEATABLE,
    SAFE,
    WORKERS,
    Options,
    add_rows,
    display,
    permit_negative_lists,
)
from avrare.cli.output import can_draw, print_warnings, say, write_files
from avrare.driving import Road
from avrare.output.plots.monitoring_plot import plot_monitoring
from avrare.output.terminal.console import make_console
from avrare.results.recordings import parse_road
from avrare.results.run import Run
from avrare_recordings.commands import monitor_batch
from avrare_recordings.drive_monitor import monitor
from avrare_recordings.output.monitoring_documents import monitoring_document, write_monitoring_csv
from avrare_recordings.output.monitoring_text import draw_chart, headline

LANE_WIDTH = 3.5
_OPTIONS: Options = {
    "file FILE": "recorded drive, folder of recorded drives, or run folder",
    "specification": {
        "--rule NAME": "traffic rule of a plugin; 'avrare rules' lists them; for many drives also A,B",
        "--set KEY=VALUE": ("set an option of the rule; may be repeated", REPEATABLE),
        "--stl FORMULA": "formula over signals or vehicles",
        "--specification NAME": "specification of the scenario or of the run",
    },
    "recording": {
        "--ego NAME": "vehicle under test (default in CSV files: ego; in a folder: all, each in turn)",
        "--scenario FILE": "scenario whose simulator provides the road",
        "--lanes Y,...": "lane centres from right to left [m]",
        "--lane-width W": (f"lane width [m] (default {LANE_WIDTH})", {"type": float}),
        "--access-ramp I,...": "indices of access ramp lanes, from 0",
        "--broad-marking I,...": "indices of lanes whose left border is a broad marking",
        "--network FILE": "CommonRoad file with the lanes of a recording in the format of inD",
        "--failure K": ("index of a run's failure (default: the worst)", {"type": int}),
    },
    **WORKERS,
    "--out DIR": "write monitor.csv, monitor.json and, of one drive, monitor.png",
    **DISPLAY,
    **SAFE,
}
_EPILOG = """\
FILE is one of
  a CSV file of signals: a column 'time' and one column per signal
  a CSV file of vehicles, one row per vehicle and time: time, vehicle, x, y,
      heading, speed, length, width and, optionally, acceleration
  a CommonRoad file: XML of 2020a, or .pb of 2024
  NN_tracks.csv of a recording in the format of highD or inD, beside its two files of metadata
  a folder of such files: every vehicle is the ego in turn (as with --ego all for one file)
  a run folder, whose stored failures are replayed

examples:
  avrare monitor gaps.csv --stl "always (gap > 2)"
  avrare monitor drive.csv --rule R_G1 --lanes -1.75,1.75,5.25 --access-ramp 0
  avrare monitor recordings --rule R_G1,R_I2 --workers 2 --out table
  avrare monitor runs/lane_change --specification safe_distance --failure 0

exit code: 0 satisfied, 1 violated, 4 bad file or usage, 5 a package or plugin is missing
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    add_rows(parser, _OPTIONS)
    permit_negative_lists(parser)


def execute(args: argparse.Namespace) -> int:
    """Score the recording and print the outcome; return exit code 1 if the specification is violated."""
    batch = monitor_batch.is_batch(args)
    _check(args, batch)
    if batch:
        return monitor_batch.execute(args, _read_lanes(args))
    scored = _monitor(args)
    print_warnings(scored.warnings)
    if args.out is not None:
        _write(scored, Path(args.out))
    if args.json:
        print(json.dumps(monitoring_document(scored)))
    else:
        _show(scored, args)
    return int(ExitCode.FAIL if scored.violated else ExitCode.PASS)


def _check(args: argparse.Namespace, batch: bool) -> None:
    chosen = [f"--{name}" for name in ("rule", "stl", "specification") if getattr(args, name) is not None]
    if args.workers != 1 and not batch:
        raise UsageError("--workers is for a folder of recordings, or for --ego all")
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


def _monitor(args: argparse.Namespace) -> MonitoringResult:
    source: Run | str = args.file
    if Path(args.file).is_dir():
        source = Run.read(args.file)
        print_warnings((line, None) for line in source.changes)
    return monitor(
        source,
        rule=args.rule,
        stl=args.stl,
        specification=args.specification,
        overrides=args.set,
        ego=args.ego,
        scenario=args.scenario,
        road=_read_lanes(args),
        network=args.network,
        failure=args.failure,
    )


def _read_lanes(args: argparse.Namespace) -> Road | None:
    if args.lanes is not None:
        width = LANE_WIDTH if args.lane_width is None else args.lane_width
        return parse_road(args.lanes, width, args.access_ramp, args.broad_marking)
    if not args.lane_width is args.access_ramp is args.broad_marking is None:
        text = "--lane-width, --access-ramp and --broad-marking require --lanes"
        raise UsageError(text, "give --lanes Y,...")
    return None


def _write(scored: MonitoringResult, folder: Path) -> None:
    write_files(folder, {"monitor.json": json.dumps(monitoring_document(scored)) + "\n"})
    with explain_file_errors(f"{folder}: cannot write", "choose another --out"):
        write_monitoring_csv(scored, folder / "monitor.csv")
        if can_draw():
            plot_monitoring(scored).save(folder / "monitor.png")


def _show(scored: MonitoringResult, args: argparse.Namespace) -> None:
    if args.quiet:
        say(*scored.lines())
        return
    console = make_console(display(args))
    for line in [*headline(scored), *([] if scored.no_vehicles else ["", *draw_chart(scored)])]:
        console.print(line)
    if args.out:
        console.print(f"\nwritten to {args.out}", markup=False)
