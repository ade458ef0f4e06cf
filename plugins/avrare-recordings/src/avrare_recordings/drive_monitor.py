"""Monitoring of a recorded drive or of a run's failure, from its file to the verdict."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from avrare.analysis.monitor.monitoring import MonitoringResult, monitor_recording
from avrare.base.errors import UsageError, did_you_mean, require_path
from avrare.driving import Road
from avrare.logic import stl
from avrare.logic.syntax import nodes
from avrare.protocols import Simulator, Specification
from avrare.results.recordings import Recording, replay_run_failure
from avrare.results.run import Run
from avrare.scenario.load import load
from avrare.scenario.overrides import as_settings
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Scenario
from avrare.stack.builder import build_block, build_formula, build_rule, build_specification
from avrare_recordings.formats.commonroad import read_commonroad
from avrare_recordings.formats.commonroad_2024 import SUFFIX
from avrare_recordings.formats.csv_recording import read_csv
from avrare_recordings.formats.drives import check_lanes, open_drives
from avrare_recordings.formats.drone_recording import is_drone_recording

Line = tuple[str, str | None]


def monitor(
    source: Run | str | os.PathLike[str],
    *,
    rule: str | None = None,
    stl: str | None = None,
    specification: str | None = None,
    overrides: Sequence[str] = (),
    ego: str | None = None,
    scenario: str | os.PathLike[str] | None = None,
    road: Road | None = None,
    network: str | None = None,
    failure: int | None = None,
    safe: bool = False,
) -> MonitoringResult:
    """Evaluate a specification on a recorded drive: is it violated, when, by whom and why.

    Args:
        source: CSV or CommonRoad file; or a run or its folder, for one of its failures.
        rule: Traffic rule of a plugin.
        stl: Formula over signals or vehicles.
        specification: Specification of the scenario or of the run.
        overrides: Options of the rule, as for ``--set``.
        ego: Vehicle under test; None: the one that a CSV file calls ego.
        scenario: Scenario file whose simulator provides the road of a recording without lanes.
        road: Lanes of a recording without any; they come before those of the scenario.
        network: CommonRoad file with the lanes of a recording in the format of inD.
        failure: Index of a run's failure; None: its least robust one.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: The arguments do not fit, or the recording lacks a signal that the specification needs.
    """
    question = _Question(rule, stl, specification, tuple(as_settings(overrides)))
    if isinstance(source, Run) or Path(require_path(source, "a recording or a run")).is_dir():
        question.require_one("rule", "stl", optional=True)
        return _monitor_failure(source if isinstance(source, Run) else Run.read(source), question, failure)
    question.require_one("rule", "stl", "specification")
    with safe_mode(safe):
        definition = None if scenario is None else load(scenario)
    other = find_road(definition) if road is None and definition is not None else road
    recording = _read(os.fspath(source), ego, other, network)
    check_lanes(recording, road)
    return _judge(question, recording, definition)


def find_road(scenario: Scenario) -> Road | None:
    """Return the road of a scenario's simulator, None where it has none."""
    scene = build_block(scenario.simulator, None, Simulator).scene
    return scene.road if scene is not None else None


@dataclass(frozen=True)
class _Question:
    rule: str | None
    stl: str | None
    specification: str | None
    settings: tuple[str, ...]

    def require_one(self, *names: str, optional: bool = False) -> None:
        values = {"rule": self.rule, "stl": self.stl, "specification": self.specification}
        chosen = [name for name in names if values[name] is not None]
        if len(chosen) > 1:
            raise UsageError(f"{' and '.join(chosen)} cannot be combined", "give one of them")
        if not chosen and not optional:
            raise UsageError("no specification given", f"give one of: {', '.join(names)}")


def _monitor_failure(run: Run, question: _Question, index: int | None) -> MonitoringResult:
    replayed = replay_run_failure(run, question.specification, index, question.rule)
    changes: list[Line] = [(line, None) for line in replayed.changes]
    if question.rule is None and question.stl is None:
        name = replayed.specification
        return _score(name, run.problem.monitor(name), replayed.recording, changes)
    return _judge(question, replayed.recording, None, changes)


def _judge(
    question: _Question, recording: Recording, scenario: Scenario | None, warnings: Sequence[Line] = ()
) -> MonitoringResult:
    name, specification = _build(question, recording, scenario)
    return _score(name, specification, recording, warnings)


def _score(
    name: str, specification: Specification, recording: Recording, warnings: Sequence[Line]
) -> MonitoringResult:
    result = monitor_recording(name, specification, recording)
    return replace(result, warnings=(*warnings, *_list_doubts(specification, recording)))


def _read(path: str, ego: str | None, road: Road | None, network: str | None) -> Recording:
    if path.lower().endswith((".xml", SUFFIX)):
        return read_commonroad(path, ego, road)
    if is_drone_recording(Path(path)) or network is not None:
        if ego is None:
            raise UsageError(f"{path}: no ego is chosen", "choose it by its id, or take all in turn")
        return open_drives(path, road, network).recording(ego)
    return read_csv(path, "ego" if ego is None else ego, road)


def _build(question: _Question, recording: Recording, scenario: Scenario | None) -> tuple[str, Specification]:
    if question.stl is not None:
        return "formula", _build_formula(question.stl, question.settings, recording)
    if question.rule is not None:
        if recording.scene is None:
            raise _missing_scene(recording, "a rule needs")
        return question.rule, build_rule(question.rule, question.settings, recording.scene)
    name = question.specification
    if scenario is None or name is None:
        raise UsageError("a specification needs the scenario that it is of", "give the scenario file")
    part = scenario.specifications.get(name)
    if part is None:
        near = did_you_mean(name, scenario.specifications)
        raise UsageError(f"{scenario.path}: unknown specification {name!r}", near)
    return name, build_specification(part, recording.scene, recording.dt)


def _build_formula(text: str, settings: Sequence[str], recording: Recording) -> Specification:
    formula = stl(text, dt=recording.dt, warn=False)
    relations = any(isinstance(part, nodes.Signal) and part.arguments for part in nodes.walk(formula.node))
    if relations and recording.scene is not None:
        return build_formula(text, settings, recording.scene)
    if settings:
        raise UsageError("a formula over signals has no options", "leave the settings out")
    if relations and not set(formula.signals) <= set(recording.signals):
        raise _missing_scene(recording, "predicates of vehicles need")
    return formula.monitor()


def _list_doubts(specification: Specification, recording: Recording) -> list[Line]:
    formula = specification.formula
    if formula is None:
        return []
    doubts: list[Line] = [(warning.message, warning.hint) for warning in formula.warnings]
    span = nodes.bounded_span(formula.node)
    if span >= recording.samples:
        text = f"the formula looks {span} samples ahead, and the recording has only {recording.samples}"
        doubts.append((f"{text}: windows are clipped at its end", "the verdict is of the recorded samples"))
    return doubts


def _missing_scene(recording: Recording, what: str) -> UsageError:
    if "ego_x" in recording.signals:
        hint = "give a scenario file, or the lanes with their centres from right to left"
        return UsageError(f"{recording.source}: {what} a road", hint)
    hint = "give a file with the columns time, vehicle, x, y, ...; or score signals by a formula"
    return UsageError(f"{recording.source}: {what} vehicles, not named signals", hint)
