"""Rules on many recorded drives: every file of a folder, every vehicle of a file as the ego, in one table.

A violation is an unbroken run of samples at which a rule's body is false. Drives of one file share their
traffic, so that the rates are those of the recordings and have no interval.
"""

from __future__ import annotations

import functools
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from avrare.analysis.monitor.cause_finder import DecisiveSample
from avrare.analysis.monitor.monitoring import describe_body, monitor_recording
from avrare.base.errors import AvrareError, UsageError, require_path
from avrare.base.number_format import format_robustness
from avrare.base.records import Answer, Records
from avrare.driving import Road
from avrare.protocols import Specification
from avrare.results.recordings import Recording
from avrare.scenario.load import load
from avrare.scenario.overrides import as_settings
from avrare.scenario.safe_mode import safe_mode
from avrare.stack.builder import build_rule
from avrare_recordings.drive_monitor import find_road
from avrare_recordings.formats.drives import Drives, check_lanes, list_recordings, open_drives

_SHOWN = 5
"""Drives of each rule, and reasons of refusals, that are named."""


@dataclass(frozen=True)
class Question:
    """Questions to ask of every drive.

    Attributes:
        rules: Names of the rules.
        settings: ``KEY=VALUE`` options of the rules.
        road: Road of recordings without lanes, or None.
        required: Refuse recordings with other lanes than ``road``.
        network: CommonRoad file with the lanelets of recordings without lanes, or None.
        ego: The only ego; None: every vehicle.
    """

    rules: tuple[str, ...]
    settings: tuple[str, ...] = ()
    road: Road | None = None
    required: bool = False
    network: str | None = None
    ego: str | None = None


@dataclass(frozen=True)
class DriveScore:
    """One rule on one drive.

    Attributes:
        file: File.
        ego: Vehicle under test.
        rule: Rule.
        violations: Number of unbroken runs of samples at which it is violated.
        robustness: Of the whole drive.
        first: Time of the first violation [s]; NaN without one.
        worst: Time of the sample that decides [s]; NaN if unknown.
        vehicles: Vehicles that decide there.
        seconds: Duration of the drive [s].
        metres: Way of the ego [m].
    """

    file: str
    ego: str
    rule: str
    violations: int
    robustness: float
    first: float
    worst: float
    vehicles: str
    seconds: float
    metres: float


@dataclass(frozen=True)
class Refusal:
    """A file, or one vehicle of it as the ego, that could not be scored, and why."""

    file: str
    ego: str
    reason: str


@dataclass(frozen=True)
class RuleTotal:
    """A rule over all drives.

    Attributes:
        rule: Name.
        drives: Number of drives.
        violated: Number of drives with a violation.
        violations: Number of violations.
        hours: Duration of all drives [h].
        kilometres: Way of all egos [km].
    """

    rule: str
    drives: int
    violated: int
    violations: int
    hours: float
    kilometres: float

    @property
    def per_hour(self) -> float:
        """Violations per hour."""
        return self.violations / self.hours if self.hours else math.nan

    @property
    def per_kilometre(self) -> float:
        """Violations per kilometre."""
        return self.violations / self.kilometres if self.kilometres else math.nan


@dataclass(frozen=True, repr=False)
class BatchResult(Answer):
    """Scores of all drives, and refusals, in the order of files, egos and rules."""

    scores: tuple[DriveScore, ...]
    refusals: tuple[Refusal, ...]

    @property
    def totals(self) -> tuple[RuleTotal, ...]:
        """Total of every rule."""
        return tuple(self._total(rule) for rule in dict.fromkeys(score.rule for score in self.scores))

    def _total(self, rule: str) -> RuleTotal:
        scores = [score for score in self.scores if score.rule == rule]
        return RuleTotal(
            rule,
            len(scores),
            sum(score.violations > 0 for score in scores),
            sum(score.violations for score in scores),
            math.fsum(score.seconds for score in scores) / 3600.0,
            math.fsum(score.metres for score in scores) / 1000.0,
        )

    def find_worst(self, rule: str, count: int = _SHOWN) -> list[DriveScore]:
        """Return the least robust drives of a rule that are violated."""
        violations = [score for score in self.scores if score.rule == rule and score.violations]
        return sorted(violations, key=lambda score: score.robustness)[:count]

    def table(self) -> Records:
        """Return one row for each rule; ``scores`` has one for each drive."""
        return Records(
            {**asdict(total), "per_hour": total.per_hour, "per_kilometre": total.per_kilometre}
            for total in self.totals
        )

    def lines(self) -> list[str]:
        """Return the violations of each rule, its worst drives, and the refusals."""
        totals = [
            f"{total.rule}: {total.violations} violations in {total.violated} of {total.drives} drives, "
            f"{total.hours:.3g} h, {total.kilometres:.3g} km"
            for total in self.totals
        ]
        return [*totals, *self.describe_worst(), *self.describe_refusals()]

    def describe_worst(self) -> list[str]:
        """Return a line for each of the worst drives of each rule."""
        return [_describe_score(score) for total in self.totals for score in self.find_worst(total.rule)]

    def describe_refusals(self) -> list[str]:
        """Return the refused drives by reason."""
        lines = [f"not read: {refusal.reason}" for refusal in self.refusals if not refusal.ego]
        reasons = Counter(refusal.reason for refusal in self.refusals if refusal.ego)
        lines += [f"not scored: {reason}" for reason in list(reasons)[:_SHOWN]]
        if len(reasons) > _SHOWN:
            lines.append(f"not scored: {len(reasons) - _SHOWN} more")
        return lines

    def to_dict(self) -> dict[str, object]:
        """Return totals, scores and refusals as plain values."""
        scores, refusals = map(asdict, self.scores), map(asdict, self.refusals)
        return {"totals": list(self.table()), "scores": list(scores), "refusals": list(refusals)}


def _describe_score(score: DriveScore) -> str:
    by = f" by {score.vehicles}" if score.vehicles else ""
    several = f", {score.violations} violations" if score.violations > 1 else ""
    worst = f"{format_robustness(score.robustness)} at {score.worst:.4g} s{by}"
    return f"{score.rule}  {score.file} ego {score.ego}: {worst}{several}"


def monitor_all(
    path: str | os.PathLike[str],
    rules: Sequence[str] | str,
    *,
    overrides: Sequence[str] = (),
    ego: str | None = None,
    scenario: str | os.PathLike[str] | None = None,
    road: Road | None = None,
    network: str | None = None,
    workers: int = 1,
    safe: bool = False,
) -> BatchResult:
    """Evaluate rules on many recorded drives: each file of a folder, each vehicle as the ego.

    Args:
        path: Folder of CommonRoad and CSV files, or one of these.
        rules: Traffic rules of a plugin: ``["R_G1", "R_I2"]``, or a single one.
        overrides: Options of the rules, as for ``--set``.
        ego: The only ego; None: every vehicle in turn.
        scenario: Scenario file whose simulator provides the road of recordings without lanes.
        road: Lanes of recordings without any; they come before those of the scenario.
        network: CommonRoad file with the lanes of recordings in the format of inD.
        workers: Number of processes; changes no number.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: No recording is found, or no rule is given.
    """
    names = (rules,) if isinstance(rules, str) else tuple(dict.fromkeys(rules))
    if not names:
        raise UsageError("many drives need a rule", "name one, such as R_G1")
    required = road is not None
    if road is None and scenario is not None:
        with safe_mode(safe):
            road = find_road(load(scenario))
    place = Path(require_path(path, "a folder of recordings"))
    files = list_recordings(place) if place.is_dir() else [place]
    question = Question(names, tuple(as_settings(overrides)), road, required, network, ego)
    return monitor_files([str(file) for file in files], question, workers)


def monitor_files(
    files: Sequence[str],
    question: Question,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> BatchResult:
    """Score every drive of the files on some processes; the result does not depend on their number."""
    scores: list[DriveScore] = []
    refusals: list[Refusal] = []
    work = [part for file in files for part in _split_vehicles(file, question, refusals)]
    for done, (new_scores, refused) in enumerate(_run(work, question, workers), start=1):
        scores += new_scores
        refusals += refused
        if progress is not None:
            progress(done, len(work))
    order = {file: place for place, file in enumerate(files)}
    return BatchResult(tuple(scores), tuple(sorted(refusals, key=lambda refusal: order[refusal.file])))


Work = tuple[str, tuple[str, ...]]


def _split_vehicles(file: str, question: Question, refusals: list[Refusal]) -> Iterator[Work]:
    try:
        names = _open(file, question).names
    except AvrareError as error:
        refusals.append(Refusal(file, "", str(error)))
        return
    if question.ego is not None:
        names = tuple(name for name in names if name == question.ego)
        if not names:
            refusals.append(Refusal(file, question.ego, f"{file}: unknown vehicle {question.ego!r}"))
    size = 25  # egos that a worker takes at a time
    for begin in range(0, len(names), size):
        yield file, names[begin : begin + size]


def _run(
    work: Sequence[Work], question: Question, workers: int
) -> Iterable[tuple[list[DriveScore], list[Refusal]]]:
    score = functools.partial(score_drives, question)
    if workers <= 1 or len(work) <= 1:
        yield from map(score, work)
        return
    with ProcessPoolExecutor(min(workers, len(work)), mp_context=get_context("spawn")) as pool:
        yield from pool.map(score, work)


@functools.lru_cache(maxsize=2)
def _open(file: str, question: Question) -> Drives:
    return open_drives(file, question.road, question.network)


def score_drives(question: Question, work: Work) -> tuple[list[DriveScore], list[Refusal]]:
    """Score some egos of one file under all rules."""
    file, egos = work
    scores, refusals = [], []
    for ego in egos:
        try:
            recording = _open(file, question).recording(ego)
            check_lanes(recording, question.road if question.required else None)
            scores += [_score(file, ego, rule, question.settings, recording) for rule in question.rules]
        except AvrareError as error:
            refusals.append(Refusal(file, ego, str(error)))
    return scores, refusals


def _score(file: str, ego: str, rule: str, settings: Sequence[str], recording: Recording) -> DriveScore:
    assert recording.scene is not None
    specification = build_rule(rule, settings, recording.scene)
    violations, robustness, first, worst = _judge(rule, specification, recording)
    speed = np.abs(recording.signals["ego_speed"])
    return DriveScore(
        file,
        ego,
        rule,
        violations,
        robustness,
        math.nan if first is None else recording.time(first.sample),
        math.nan if worst is None else recording.time(worst.sample),
        "" if worst is None else ", ".join(_names(worst)),
        recording.dt * (recording.samples - 1),
        float(0.5 * recording.dt * (speed[1:] + speed[:-1]).sum()),
    )


def _judge(
    rule: str, specification: Specification, recording: Recording
) -> tuple[int, float, DecisiveSample | None, DecisiveSample | None]:
    described = describe_body(specification, recording)
    if described is None:  # no ``always`` formula: the drive as a whole is violated or not
        whole = monitor_recording(rule, specification, recording)
        return int(whole.violated), whole.robustness, whole.first, whole.worst
    body, truth, first, worst = described
    runs = int((~truth[1:] & truth[:-1]).sum() + (not truth[0]))
    return runs, float(body.min()), first, worst


def _names(decisive: DecisiveSample) -> Iterable[str]:
    vehicles: Mapping[str, str] = decisive.vehicles
    return vehicles.values()
