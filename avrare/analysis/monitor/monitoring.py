"""Monitoring of a recorded drive under a specification: robustness over time, and its causes."""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass

import numpy as np

from avrare.analysis.monitor.cause_finder import (
    CauseFinder,
    DecisiveSample,
    Inputs,
    find_always_body,
    is_pointwise,
)
from avrare.analysis.monitor.long_recordings import Stretches
from avrare.base.errors import UsageError
from avrare.base.number_format import format_robustness
from avrare.base.records import Answer, Records
from avrare.logic.formula import Formula
from avrare.logic.syntax import nodes
from avrare.protocols import Bools, Floats, Specification
from avrare.results.recordings import Recording


@dataclass(frozen=True, repr=False)
class MonitoringResult(Answer):
    """A recording under one specification."""

    name: str
    formula: str  # text; empty if the specification has none
    recording: Recording
    prefix: Floats  # (T,) robustness of samples 0..t
    prefix_violated: Bools  # (T,) samples 0..t violate the specification
    body: Floats | None  # (T,) for ``always φ``: robustness of φ at each sample
    first: DecisiveSample | None  # earliest violation; None without one, or if no single sample can violate
    worst: DecisiveSample | None  # decides the robustness; None if unknown
    pointwise: bool = True  # one sample can violate, as with ``always``: ``worst`` is the least robust
    no_vehicles: bool = False  # it quantifies over vehicles, and the recording has none of them
    excluded: tuple[str, ...] = ()  # vehicles of the recording that it ignores
    warnings: tuple[tuple[str, str | None], ...] = ()  # messages with hints

    @property
    def robustness(self) -> float:
        """Robustness of the complete recording."""
        return float(self.prefix[-1])

    @property
    def violated(self) -> bool:
        """Verdict on the complete recording."""
        return bool(self.prefix_violated[-1])

    def table(self) -> Records:
        """Return one row for each sample."""
        body = self.prefix if self.body is None else self.body
        return Records(
            {
                "time": self.recording.time(t),
                "robustness": float(body[t]),
                "robustness_so_far": float(self.prefix[t]),
                "violated": bool(self.prefix_violated[t]),
            }
            for t in range(self.recording.samples)
        )

    def lines(self) -> list[str]:
        """Return verdict, deciding samples and causes in one sentence."""
        return [summarise(self)]


def summarise(result: MonitoringResult) -> str:
    """Return one sentence: verdict, deciding samples and causes.

    For example ``R_G1 violated first at 2.1 s with car: gap(ego, car) has robustness -0.1 (worst robustness
    -0.31 at 2.8 s)``.
    """
    verdict = f"{result.name} {'violated' if result.violated else 'satisfied'}"
    robustness = format_robustness(result.robustness)
    first, worst = result.first, result.worst
    if result.no_vehicles:
        return f"{verdict}: there are no vehicles that it applies to{list_exclusions(result)}"
    if not result.pointwise or (result.violated and first is None):
        decided = "" if worst is None else f", decided {_describe(result, worst)}"
        return f"{verdict} with robustness {robustness}{decided}"
    if first is None:
        least = "" if worst is None else f", least {_describe(result, worst)}"
        return f"{verdict} with robustness {robustness}{least}"
    if worst is not None and worst.sample == first.sample:
        same = format_robustness(first.value) == robustness
        overall = "" if same else f" (overall robustness {robustness})"
        return f"{verdict} first and worst {_describe(result, first)}{overall}"
    # A part may be further from holding than the formula, where other parts make up for it.
    overall = ""
    if first.value < first.robustness:
        overall = f"whole formula {format_robustness(first.robustness)} there, "
    at = "" if worst is None else f" at {format_sample_time(result.recording, worst.sample)} s"
    limit = f", decided by {worst.limit}" if worst is not None and worst.limit and overall else ""
    return f"{verdict} first {_describe(result, first)} ({overall}worst robustness {robustness}{at}{limit})"


def _describe(result: MonitoringResult, decisive: DecisiveSample) -> str:
    # for example ``at 2.1 s with cut_in: at 1.8 s speed(cut_in) > 3 has robustness -0.12``
    vehicles, existential = decisive.vehicles.items(), decisive.existential
    names = dict.fromkeys(name for variable, name in vehicles if variable not in existential)
    nearest = dict.fromkeys(name for variable, name in vehicles if variable in existential)
    text = f"at {format_sample_time(result.recording, decisive.sample)} s"
    text += f" with {' and '.join(names)}" if names else ""
    if nearest:
        text += f", {'nearest' if result.violated else 'thanks to'} {' and '.join(nearest)}"
    if not decisive.formula:
        return text
    at = ""
    if decisive.formula_sample != decisive.sample:
        at = f"at {format_sample_time(result.recording, decisive.formula_sample)} s "
    return f"{text}: {at}{_describe_formula(decisive)}"


def _describe_formula(decisive: DecisiveSample) -> str:
    # ``gap = -0.12``, or ``gap > 2 has robustness -0.5`` if the robustness is not the value
    robustness = format_robustness(decisive.value)
    term = re.fullmatch(r"(\w+)(\([^()]*\))?(?: >=? 0)?", decisive.formula)
    if term is not None and term[2] is None:
        return f"{term[1]} = {robustness}"
    return f"{decisive.formula if term is None else term[1] + term[2]} has robustness {robustness}"


def list_exclusions(result: MonitoringResult) -> str:
    """Return the vehicles that the specification ignores, in brackets."""
    return f" (excluded: {', '.join(result.excluded)})" if result.excluded else ""


def format_sample_time(recording: Recording, sample: int) -> str:
    """Return the time of a sample with as many digits as the step needs, for example ``2.1``."""
    digits = next((k for k in range(1, 4) if abs(round(recording.dt, k) - recording.dt) < 1e-9), 3)
    return f"{recording.time(sample):.{digits}f}"


def monitor_recording(name: str, specification: Specification, recording: Recording) -> MonitoringResult:
    """Run the monitor of a specification along a recording; one with a formula is also explained.

    UsageError if signals are missing, or if the formula has no value for them.
    """
    prefix, violated = _run_monitor(specification, recording)
    formula = specification.formula
    if formula is None:
        first = None
        if violated[-1]:
            sample = int(np.argmax(violated))
            first = DecisiveSample(sample, float(prefix[sample]), {}, "", math.nan, sample)
        return MonitoringResult(name, "", recording, prefix, violated, None, first, None)
    names = list_vehicle_names(specification, recording)
    members = {"others": names} if names else {}
    body, first, worst = _find_causes(specification, recording, formula, members, bool(violated[-1]))
    pointwise = is_pointwise(formula.node)
    quantified = any(isinstance(part, nodes.Quantifier) for part in nodes.walk(formula.node))
    return MonitoringResult(
        name,
        formula.text,
        recording,
        prefix,
        violated,
        body,
        first=first if pointwise else None,
        worst=worst,
        pointwise=pointwise,
        no_vehicles=not names and quantified,
        excluded=tuple(specification.excluded),
    )


def _find_causes(
    specification: Specification,
    recording: Recording,
    formula: Formula,
    members: dict[str, tuple[str, ...]],
    violated: bool,
) -> tuple[Floats | None, DecisiveSample | None, DecisiveSample | None]:
    # The body of an ``always`` formula, the earliest violation, and the sample that decides.
    inner = find_always_body(formula.node)
    stretches = _make_stretches(specification, recording, formula)
    if stretches is None or stretches.reads_all:
        inputs = select_inputs(specification, recording)
        body = None if inner is None else dataclasses.replace(formula, derived=inner).robustness(inputs)[0]
        explanation = formula.explain(inputs, members)
        causes = CauseFinder(formula, inputs, members, body)
        first = causes.find(explanation, earliest=True) if violated else None
        return body, first, causes.find(explanation, earliest=False)
    body, _, first, worst = _explain_stretches(stretches, members)
    return body, first if violated else None, worst


Body = tuple[Floats, Bools, DecisiveSample | None, DecisiveSample]
"""Robustness and truth of an ``always`` formula's body, its first violation and its decisive sample."""


def describe_body(specification: Specification, recording: Recording) -> Body | None:
    """Evaluate the body of an ``always`` formula on a recording, without its value over time.

    None if the specification is another formula, or the body reads the whole recording.
    """
    formula = specification.formula
    stretches = None if formula is None else _make_stretches(specification, recording, formula)
    if stretches is None or stretches.is_unbounded or not is_pointwise(stretches.formula.node):
        return None
    names = list_vehicle_names(specification, recording)
    return _explain_stretches(stretches, {"others": names} if names else {})


def _make_stretches(specification: Specification, recording: Recording, formula: Formula) -> Stretches | None:
    def read(first: int, end: int) -> Inputs:
        return select_inputs(specification, recording, slice(first, end))

    inner = find_always_body(formula.node)
    if inner is None:
        return None
    return Stretches(formula, inner, read, recording.samples, len(recording.names))


def _explain_stretches(stretches: Stretches, members: dict[str, tuple[str, ...]]) -> Body:
    body, truth = stretches.evaluate()

    def explain(sample: int, earliest: bool) -> DecisiveSample:
        begin, inputs, explanation = stretches.explain(sample, members)
        causes = CauseFinder(stretches.formula, inputs, members, body[begin:])
        cause = causes.find(explanation, earliest)
        at = {name: getattr(cause, name) + begin for name in ("sample", "formula_sample")}
        return dataclasses.replace(cause, **at)

    first = None if truth.all() else explain(int(np.argmin(truth)), True)
    return body, truth, first, explain(int(np.argmin(body)), False)


def select_inputs(specification: Specification, recording: Recording, span: slice = slice(None)) -> Inputs:
    """Return the signals of the specification's formula, (1, T, ...) each, at the samples of a span."""
    # Predicates take batches of one sample: time serves as their batch axis.
    signals = {key: values[span] for key, values in recording.signals.items()}
    return {key: np.asarray(x)[None] for key, x in specification.sample(signals).items()}


def list_vehicle_names(specification: Specification, recording: Recording) -> tuple[str, ...]:
    """Return the names of the vehicles that the specification's quantifiers range over."""
    return tuple(recording.names if specification.names is None else specification.names)


def _run_monitor(specification: Specification, recording: Recording) -> tuple[Floats, Bools]:
    prefix, violated = np.zeros(recording.samples), np.zeros(recording.samples, dtype=bool)
    state = specification.start(1)
    for t in range(recording.samples):
        sample = {key: values[t : t + 1] for key, values in recording.signals.items()}
        state, verdict = specification.update(state, sample)
        prefix[t], violated[t] = verdict.robustness[0], verdict.violated[0]
        if math.isnan(prefix[t]):
            message = f"the formula has no value (NaN) at {recording.time(t):g} s"
            raise UsageError(f"{recording.source}: {message}", "look for a difference of infinities, or 0/0")
    return prefix, violated
