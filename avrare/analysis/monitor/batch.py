"""Rules on many recorded drives: every file of a folder, every vehicle of a file as the ego, in one table.

A violation is an unbroken run of samples at which a rule's body is false. Drives of one file share their
traffic, so that the rates are those of what was recorded and have no interval.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np

from avrare.analysis.monitor.cause_finder import DecisiveSample
from avrare.analysis.monitor.monitoring import describe_body, monitor_recording
from avrare.base.errors import AvrareError
from avrare.driving import Road
from avrare.protocols import Specification
from avrare.results.recordings.drives import Drives, open_drives
from avrare.results.recordings.recording import Recording
from avrare.stack.builder import build_rule

_PART = 25  # egos of one file that a worker takes at a time


@dataclass(frozen=True)
class Question:
    """Questions to ask of every drive.

    Attributes:
        rules: Names of the rules.
        settings: ``KEY=VALUE`` options of the rules.
        road: The caller's road, or None.
        network: CommonRoad file with the lanelets of recordings without lanes, or None.
        ego: The only ego; None: every vehicle.
    """

    rules: tuple[str, ...]
    settings: tuple[str, ...] = ()
    road: Road | None = None
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


@dataclass(frozen=True)
class BatchResult:
    """Scores of all drives and what could not be scored, in the order of files, egos and rules."""

    scores: tuple[DriveScore, ...]
    refusals: tuple[Refusal, ...]

    @property
    def totals(self) -> tuple[RuleTotal, ...]:
        """Total of every rule."""
        return tuple(self._total(rule) for rule in dict.fromkeys(score.rule for score in self.scores))

    def _total(self, rule: str) -> RuleTotal:
        mine = [score for score in self.scores if score.rule == rule]
        return RuleTotal(
            rule,
            len(mine),
            sum(score.violations > 0 for score in mine),
            sum(score.violations for score in mine),
            math.fsum(score.seconds for score in mine) / 3600.0,
            math.fsum(score.metres for score in mine) / 1000.0,
        )

    def find_worst(self, rule: str, count: int = 5) -> list[DriveScore]:
        """Return the least robust drives of a rule that are violated."""
        mine = [score for score in self.scores if score.rule == rule and score.violations]
        return sorted(mine, key=lambda score: score.robustness)[:count]

    def as_document(self) -> dict[str, Any]:
        """Return totals, scores and refusals as plain values."""
        totals = [
            {**asdict(total), "per_hour": total.per_hour, "per_kilometre": total.per_kilometre}
            for total in self.totals
        ]
        scores, refusals = map(asdict, self.scores), map(asdict, self.refusals)
        return {"totals": totals, "scores": list(scores), "refusals": list(refusals)}


def monitor_files(
    files: Sequence[str],
    question: Question,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> BatchResult:
    """Score every drive of the files, on ``jobs`` processes; the result does not depend on their number."""
    scores: list[DriveScore] = []
    refusals: list[Refusal] = []
    work = [part for file in files for part in _split(file, question, refusals)]
    for done, (mine, refused) in enumerate(_run(work, question, jobs), start=1):
        scores += mine
        refusals += refused
        if progress is not None:
            progress(done, len(work))
    order = {file: place for place, file in enumerate(files)}
    return BatchResult(tuple(scores), tuple(sorted(refusals, key=lambda one: order[one.file])))


Work = tuple[str, tuple[str, ...]]


def _split(file: str, question: Question, refusals: list[Refusal]) -> Iterator[Work]:
    try:
        names = _open(file, question).names
    except AvrareError as error:
        refusals.append(Refusal(file, "", str(error)))
        return
    if question.ego is not None:
        names = tuple(name for name in names if name == question.ego)
        if not names:
            refusals.append(Refusal(file, question.ego, f"{file}: there is no vehicle {question.ego!r}"))
    for begin in range(0, len(names), _PART):
        yield file, names[begin : begin + _PART]


def _run(
    work: Sequence[Work], question: Question, jobs: int
) -> Iterable[tuple[list[DriveScore], list[Refusal]]]:
    score = functools.partial(score_drives, question)
    if jobs <= 1 or len(work) <= 1:
        yield from map(score, work)
        return
    with ProcessPoolExecutor(min(jobs, len(work)), mp_context=get_context("spawn")) as pool:
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
    found = describe_body(specification, recording)
    if found is None:  # no ``always`` formula: the drive as a whole is violated or not
        whole = monitor_recording(rule, specification, recording)
        return int(whole.violated), whole.robustness, whole.first, whole.worst
    body, truth, first, worst = found
    runs = int((~truth[1:] & truth[:-1]).sum() + (not truth[0]))
    return runs, float(body.min()), first, worst


def _names(decisive: DecisiveSample) -> Iterable[str]:
    vehicles: Mapping[str, str] = decisive.vehicles
    return vehicles.values()
