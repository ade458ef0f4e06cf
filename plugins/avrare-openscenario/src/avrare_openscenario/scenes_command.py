"""Command ``avrare scenes``: which OpenSCENARIO files are read, and the first obstacle of the others."""

from __future__ import annotations

import argparse
import json
import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from avrare.base.errors import ExitCode, UsageError
from avrare_openscenario.acted_traffic import ActedTraffic
from avrare_openscenario.scenario_file import ScenarioFile, read_scenario
from avrare_openscenario.trace import draw_scene, write_trace
from avrare_openscenario.xml_tree import read_xml

_PLACE = re.compile(r"(?P<path>.*?\.\w+):(?P<line>\d+)(?::\d+)?: (?P<reason>.*)", re.DOTALL)
_FEATURE = re.compile(
    r"\w+(Action|Condition|Position|Target|TargetSpeed)|Polyline|Clothoid\w*|Nurbs|ConstraintGroup"
)
_STEP = 0.1
"""Step with which files are read [s]."""
_EPILOG = """\
A file is read, read with notes on what changes nothing, or refused at the first thing that is not read.
Of a folder, all files .xosc with a storyboard are taken. All entities obey the file, the ego too.

examples:
  avrare scenes openscenario/
  avrare scenes cut_in.xosc --trace drive.csv --dt 0.01 --until 20
  avrare scenes cut_in.xosc --picture drive.png

exit code: 0 all are read, 1 some are refused
"""


@dataclass(frozen=True)
class Finding:
    """Judgement of one file.

    Attributes:
        file: Its path.
        status: Whether it is read, with notes or without, or refused.
        reason: The first obstacle, or the notes.
        line: Line of the obstacle, in the file that ``reason`` names or this one; None: of no line.
        features: Names of the elements in it that act, ask or place.
    """

    file: str
    status: Literal["read", "notes", "refused"]
    reason: str
    line: int | None
    features: tuple[str, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.epilog, parser.formatter_class = _EPILOG, argparse.RawDescriptionHelpFormatter
    parser.add_argument("paths", nargs="+", metavar="FILE", help="OpenSCENARIO file, or folder of such files")
    parser.add_argument("--json", action="store_true", help="print a list of {file, status, reason, ...}")
    parser.add_argument("--trace", metavar="OUT.csv", help="act one scene out and write all states")
    parser.add_argument("--picture", metavar="OUT.png", help="act one scene out and draw the ways of all")
    parser.add_argument("--dt", type=float, default=0.01, metavar="S", help="step of both [s] (0.01)")
    parser.add_argument("--until", type=float, default=20.0, metavar="S", help="end of both [s] (20)")


def execute(args: argparse.Namespace) -> int:
    """Judge all files, or act one of them out."""
    if args.trace is not None or args.picture is not None:
        return _act_out(args)
    findings = [judge_scene(path) for path in list_scenes(args.paths)]
    if args.json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        _print_table(findings)
    refused = any(finding.status == "refused" for finding in findings)
    return int(ExitCode.FAIL if refused else ExitCode.PASS)


def list_scenes(paths: Sequence[str]) -> list[str]:
    """Return the files, and those with a storyboard in the folders.

    Raises:
        UsageError: A path does not exist, or a folder has no scene.
    """
    scenes: list[str] = []
    for path in paths:
        if not Path(path).exists():
            raise UsageError(f"{path}: no such file or folder", "check the path")
        if not Path(path).is_dir():
            scenes.append(path)
            continue
        inside = [str(file) for file in sorted(Path(path).rglob("*.xosc")) if _has_storyboard(file)]
        if not inside:
            raise UsageError(f"{path}: has no file .xosc with a storyboard")
        scenes += inside
    return scenes


def judge_scene(path: str) -> Finding:
    """Return whether a file can be read, with the notes on it or the reason and its place."""
    features: tuple[str, ...] = ()
    try:
        top = read_xml(path, "OpenSCENARIO")
        features = tuple(sorted({element.tag for element in top.walk() if _FEATURE.fullmatch(element.tag)}))
        file = read_acted(path, _STEP)
        notes = (*file.notes, *list_spent_edges(file))
    except UsageError as error:
        place = _PLACE.fullmatch(error.message)
        if place is None:
            return Finding(path, "refused", error.message, None, features)
        other = "" if place["path"] == path else f"{os.path.basename(place['path'])}: "
        return Finding(path, "refused", other + place["reason"], int(place["line"]), features)
    return Finding(path, "notes" if notes else "read", "; ".join(_shorten(notes)), None, features)


def read_acted(path: str, dt: float) -> ScenarioFile:
    """Return a scene all of whose entities obey its file.

    Raises:
        UsageError: Something is not understood, or a vehicle starts off the road.
    """
    file = read_scenario(path, None, dt, {})
    ActedTraffic(file, dt).check_start()
    return file


def list_spent_edges(file: ScenarioFile) -> list[str]:
    """Return a note where a condition with a rising edge holds from the start: it may never fire."""
    traffic = ActedTraffic(file, _STEP)
    _, memory = traffic.start(1, {})
    memory = traffic.step(memory, np.array([0]), None)
    edges = zip(file.story.conditions, memory.before[0].tolist(), strict=True)
    if all(condition.edge != "rising" or was != 1 for condition, was in edges):
        return []
    return [f"{file.path}: a rising edge that holds at its first check fires only after it was false"]


def _act_out(args: argparse.Namespace) -> int:
    if len(args.paths) != 1 or args.json:
        raise UsageError("--trace and --picture act out one scene", "name one file, without --json")
    if not (0.0 < args.dt <= args.until):
        raise UsageError(f"--dt {args.dt:g} --until {args.until:g}: should be 0 < dt <= until")
    file = read_acted(args.paths[0], args.dt)
    for target, write in ((args.trace, write_trace), (args.picture, draw_scene)):
        if target is not None and not Path(target).parent.is_dir():
            raise UsageError(f"{target}: there is no folder {Path(target).parent}")
        if target is not None:
            write(Path(target), file, args.dt, args.until)
    return int(ExitCode.PASS)


def _has_storyboard(file: Path) -> bool:
    try:
        return re.search(rb"<Storyboard[\s>]", file.read_bytes()) is not None
    except OSError:
        return True  # the reader says what is wrong


def _shorten(notes: Sequence[str]) -> list[str]:
    # Each note once, without its places.
    return list(dict.fromkeys(note.split(": ", 1)[1] for note in notes))


def _print_table(findings: Sequence[Finding]) -> None:
    for finding in findings:
        place = finding.file if finding.line is None else f"{finding.file}:{finding.line}"
        print(f"{finding.status:<8} {place}" + (f": {finding.reason}" if finding.reason else ""))
    counts = Counter(finding.status for finding in findings)
    totals = ", ".join(f"{counts[name]} {name}" for name in ("read", "notes", "refused"))
    print(f"{len(findings)} scenes: {totals}")
