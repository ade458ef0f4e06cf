"""Sentence about a monitored recording."""

from __future__ import annotations

import re

from avrare.analysis.monitor.monitoring import DecisiveSample, MonitoringResult
from avrare.base.number_format import format_robustness
from avrare.results.recordings.recording import Recording


def summarise(result: MonitoringResult) -> str:
    """Return one sentence: verdict, deciding samples and causes.

    For example ``R_G1 violated first at 2.1 s with car: gap(ego, car) has robustness -0.1 (worst robustness
    -0.31 at 2.8 s)``.
    """
    verdict = f"{result.name} {'violated' if result.violated else 'satisfied'}"
    robustness = format_robustness(result.robustness)
    first, worst = result.first, result.worst
    if result.no_vehicles:
        return f"{verdict}: there are no vehicles that it applies to{list_excluded(result)}"
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
    overall = " overall" if first.value < first.robustness else ""
    at = "" if worst is None else f" at {format_sample_time(result.recording, worst.sample)} s"
    limit = f", decided by {worst.limit}" if worst is not None and worst.limit and overall else ""
    return f"{verdict} first {_describe(result, first)} (worst{overall} robustness {robustness}{at}{limit})"


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


def list_excluded(result: MonitoringResult) -> str:
    """Return the vehicles that the specification ignores, in brackets; empty without any."""
    return f" (excluded: {', '.join(result.excluded)})" if result.excluded else ""


def format_sample_time(recording: Recording, sample: int) -> str:
    """Return the time of a sample with as many digits as the step needs, for example ``2.1``."""
    digits = next((k for k in range(1, 4) if abs(round(recording.dt, k) - recording.dt) < 1e-9), 3)
    return f"{recording.time(sample):.{digits}f}"
