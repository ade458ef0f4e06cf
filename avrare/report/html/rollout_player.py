"""Rollouts in a report: stored ones are selected, replayed and shown in a player.

A player has a top view or signals, robustness over time, predicates and noise.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult, monitor_recording
from avrare.base.errors import AvrareError, UsageError
from avrare.base.number_format import format_robustness
from avrare.estimation.result import Failures
from avrare.protocols import Floats
from avrare.report.html.heat_strips import draw_noise, draw_predicates
from avrare.report.html.line_chart import LineChart, Scale, make_linear_scale, render_legend
from avrare.report.html.markup import Markup, json_block, tag
from avrare.report.plots.rollout_plot import Frame, extract_frames
from avrare.report.terminal.monitoring_text import summarise
from avrare.results.reader import RolloutSample
from avrare.results.recordings.replayed_failure import record_rollout
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.replay import ReplayedRollout, replay_tapes
from avrare.stack.drawn_start import SIGNAL

_LEAD = 3.0  # time before the failure at which the player opens [s]
_MAX_SIGNALS = 12
_LEVELS = ("longitudinal_acceleration", "lateral_acceleration", "jerk", "time_to_collision")
"""Signals that are drawn beside a top view, where the simulator has them."""
_MAX_NUMBERS = 60_000  # largest size of plans and predictions; a longer rollout is shown without them


@dataclass(frozen=True)
class StoredRollout:
    """A stored rollout with its tape (steps + 1, noise_size); ``title`` says why it is shown."""

    title: str
    specification: str
    tape: Floats
    robustness: float
    failed: bool

    @property
    def norm(self) -> float:
        """Norm of the noise; the smaller, the more likely."""
        return float(np.sqrt(np.square(self.tape).sum()))


@dataclass(frozen=True)
class MonitoredRollout:
    """A stored rollout, replayed and monitored.

    Without a result it cannot be shown, for the reason ``problem``; without vehicles it has no frames.
    """

    stored: StoredRollout
    result: MonitoringResult | None
    frames: tuple[Frame, ...] = ()
    problem: str = ""


def select_rollouts(
    name: str, failures: Failures | None, sample: RolloutSample | None
) -> list[StoredRollout]:
    """Return the worst and the most likely stored failure, or the rollout nearest to a failure."""
    if failures is None or not len(failures.robustness):
        if sample is None or np.isnan(sample.worst.robustness):
            return []
        noise, robustness = sample.worst.noise, sample.worst.robustness
        return [StoredRollout("Nearest to a failure", name, noise, robustness, False)]
    worst = int(np.argmin(failures.robustness))
    likely = int(np.argmin(np.square(failures.noise).sum(axis=(1, 2))))
    titles = {worst: "Worst failure"}
    titles[likely] = f"{'Worst and likeliest' if likely == worst else 'Likeliest'} stored failure"
    return [
        StoredRollout(title, name, failures.noise[k], float(failures.robustness[k]), True)
        for k, title in titles.items()
    ]


def replay_stored(scenario: LoadedScenario, stored: Sequence[StoredRollout]) -> list[MonitoredRollout]:
    """Replay rollouts in one batch and monitor them."""
    if not stored:
        return []
    if len({one.tape.shape for one in stored}) > 1:
        raise UsageError("the stored tapes have different shapes", "run the scenario again")
    missing = [one.specification for one in stored if one.specification not in scenario.specifications]
    if missing:
        raise UsageError(f"its scenario.yaml has no specification {missing[0]!r}", "run the scenario again")
    problem = scenario.problem(scenario.specifications)
    rollouts = replay_tapes(problem, np.stack([one.tape for one in stored]))
    return [_monitor(scenario, one, rollout) for one, rollout in zip(stored, rollouts, strict=True)]


def _monitor(scenario: LoadedScenario, stored: StoredRollout, rollout: ReplayedRollout) -> MonitoredRollout:
    if rollout.error is not None:
        text = f"the rollout ended with an error after {len(rollout.states)} samples"
        return MonitoredRollout(stored, None, problem=text)
    recording = record_rollout(scenario, rollout, scenario.name)
    specification = scenario.stack.specifications[stored.specification]
    try:
        result = monitor_recording(stored.specification, specification, recording)
    except AvrareError as error:
        return MonitoredRollout(stored, None, problem=error.message)
    return MonitoredRollout(stored, result, tuple(extract_frames(scenario, rollout)))


def render_player(rollout: MonitoredRollout, scenario: LoadedScenario, opened: bool) -> Markup:
    """Return everything about one rollout, synchronised by one clock."""
    stored, result = rollout.stored, rollout.result
    summary = tag("summary", tag("h3", stored.title), tag("span", _describe_rollout(stored), class_="muted"))
    if result is None:
        return tag("details", summary, tag("p", f"It cannot be shown: {rollout.problem}."), open=opened)
    decisive = [one for one in (result.first, result.worst) if one is not None]
    marked = sorted({name for one in decisive for name in one.vehicles.values()})
    return tag(
        "details", summary,
        tag("p", typeset_minus(summarise(result)), class_="sentence"),
        _render_difference(stored, result), _render_drawn(result),
        tag(
            "div", _render_stage(result), json_block(_tabulate_view(result, rollout.frames, marked)),
            _draw_robustness(result), draw_predicates(scenario.stack.specifications[result.name], result),
            _draw_levels(result), draw_noise(scenario, stored.tape, stored.failed),
            class_="player", data_start=_select_start(result),
        ),
        open=opened,
    )  # fmt: skip


def _render_drawn(result: MonitoringResult) -> Markup | None:
    drawn = {name: values for name, values in result.recording.signals.items() if name.startswith(SIGNAL)}
    rows = [
        tag("div", tag("dt", name.removeprefix(SIGNAL).replace("_", " ")), tag("dd", f"{values[0]:.4g}"))
        for name, values in drawn.items()
    ]
    return tag("div", tag("p", "Drawn at the start:"), tag("dl", rows, class_="facts")) if rows else None


def typeset_minus(text: str) -> str:
    """Replace the hyphens before numbers by minus signs."""
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)


def _describe_rollout(stored: StoredRollout) -> str:
    expected = math.sqrt(stored.tape.size)
    robustness = typeset_minus(format_robustness(stored.robustness))
    return f"robustness {robustness} · norm of the noise {stored.norm:.3g} (random rollouts: {expected:.3g})"


def _render_difference(stored: StoredRollout, result: MonitoringResult) -> Markup | None:
    now, then = result.robustness, stored.robustness
    if now == then:
        return None
    return tag(
        "p", f"Its robustness is now {typeset_minus(f'{now:.9g}')}, not {typeset_minus(f'{then:.9g}')} as "
        "stored: the version or the machine differs.", class_="note",
    )  # fmt: skip


def _select_start(result: MonitoringResult) -> int:
    """Return the sample at which the player opens: three seconds before what it is shown for."""
    decisive = result.first or result.worst
    before = round(_LEAD / result.recording.dt)
    return max(decisive.sample - before, 0) if decisive is not None else 0


def _render_stage(result: MonitoringResult) -> Markup:
    recording = result.recording
    start, last = _select_start(result), recording.samples - 1
    controls = tag(
        "div",
        tag("button", "Play", type="button", class_="play"),
        tag("input", type="range", min=0, max=last, step=1, value=start, aria_label="time"),
        tag("output", f"{recording.time(start):.2f} s"),
        tag("button", "1×", type="button", class_="speed", aria_label="playback speed"),
        class_="controls",
    )  # fmt: skip
    if recording.scene is None:
        return tag("div", _draw_signals(result), controls)
    description = f"Top view of the rollout: {summarise(result)}"
    key = render_legend(
        ("car ego", "ego"), ("car other", "others"), ("car decisive", "decides"), ("dot seen", "observed"),
        ("ring", "missed"), ("line accent", "plan"), ("line predicted", "predicted"),
    )  # fmt: skip
    canvas = tag("canvas", description, role="img", aria_label=description, class_="view")
    return tag("div", canvas, tag("div", key, class_="legend"), controls)


def _make_time_axis(result: MonitoringResult) -> tuple[Floats, Scale]:
    # Each sample is as wide as its pixel in the strips below.
    times, half = result.recording.times, 0.5 * result.recording.dt
    return times, Scale(float(times[0]) - half, float(times[-1]) + half)


def _draw_signals(result: MonitoringResult) -> Markup:
    # scalar ones, those of the formula first
    scalar = [name for name, values in result.recording.signals.items() if np.ndim(values) == 1]
    chosen = sorted(scalar, key=lambda one: one not in result.formula)[:_MAX_SIGNALS]
    return tag("div", _draw_lines(result, chosen), class_="signals")


def _draw_levels(result: MonitoringResult) -> Markup | None:
    recording = result.recording
    names = [name for name in _LEVELS if name in recording.signals and recording.scene is not None]
    return tag("div", _draw_lines(result, names), class_="signals") if names else None


def _draw_lines(result: MonitoringResult, names: Sequence[str]) -> list[Markup]:
    times, x = _make_time_axis(result)
    figures = []
    for name in names:
        values = np.asarray(result.recording.signals[name], dtype=np.float64)
        chart = LineChart(x, make_linear_scale(values.tolist()), f"Signal {name} over time", over_time=True)
        chart.draw_line(times, values, "accent")
        figures.append(chart.render(name, height=84))
    return figures


def _draw_robustness(result: MonitoringResult) -> Markup:
    times, x = _make_time_axis(result)
    values = result.prefix if result.body is None else result.body
    title = f"Robustness over time, least {format_robustness(result.robustness)}"
    y = make_linear_scale([*values.tolist(), *result.prefix.tolist()], zero=True)
    chart = LineChart(x, y, title, "time [s]", over_time=True)
    chart.fill_below_zero(times, values)
    chart.draw_zero()
    entries = [("line dashed", "of the samples so far")]
    if result.body is not None:
        chart.draw_line(times, result.body, "accent")
        entries.insert(0, ("line accent", "at each sample"))
    chart.draw_line(times, result.prefix, "dashed")
    for decisive in (result.first, result.worst):
        if decisive is not None and math.isfinite(decisive.robustness):
            at = np.array([decisive.sample])
            chart.draw_dots(times[at], values[at], "violated" if result.violated else "accent")
    entries.append(("box violated", "violated"))
    return tag("div", chart.render("Robustness", render_legend(*entries), height=150), class_="gutter")


def _tabulate_view(
    result: MonitoringResult, frames: Sequence[Frame], marked: Sequence[str]
) -> dict[str, Any]:
    # Positions are in metres, to the centimetre.
    recording = result.recording
    content: dict[str, Any] = {"dt": recording.dt, "samples": recording.samples}
    scene = recording.scene
    if scene is None or not frames:
        return content
    road = scene.road
    content["road"] = {
        "lanes": list(road.lane_centres), "width": road.lane_width, "ramp": list(road.access_ramp),
    }  # fmt: skip
    content["ego"] = {"l": scene.ego_length, "w": scene.ego_width, **_encode_trajectory(frames, "ego", 0)}
    content["others"] = [
        {
            "name": name,
            "l": float(scene.lengths[v]),
            "w": float(scene.widths[v]),
            "moving": bool(scene.moving[v]),
            "marked": name in marked,
            **_encode_trajectory(frames, "others", (0, v)),
        }
        for v, name in enumerate(scene.names)
    ]
    content["seen"] = [_encode_observation(frame, len(scene.names)) for frame in frames]
    plans = [None if one.plan is None else _round_points(one.plan[:, :2]) for one in frames]
    predictions = [_encode_prediction(frame) for frame in frames]
    if _count_numbers(plans) + _count_numbers(predictions) <= _MAX_NUMBERS:
        content |= {"plan": plans, "predicted": predictions}
    return content


def _encode_trajectory(frames: Sequence[Frame], who: str, at: Any) -> dict[str, list[float]]:
    vehicles = [getattr(frame.world, who) for frame in frames]
    return {
        key: [_round(getattr(one, field)[at], digits) for one in vehicles]
        for key, field, digits in (("x", "x", 2), ("y", "y", 2), ("h", "heading", 4), ("v", "speed", 2))
    }


def _encode_observation(frame: Frame, vehicles: int) -> list[list[float] | int] | None:
    # the observed position of each vehicle, 0 if it was missed, and those of false detections
    observed = frame.observation
    if observed is None:
        return None
    return [
        [_round(observed.x[0, v]), _round(observed.y[0, v])] if observed.detected[0, v] else 0
        for v in range(observed.x.shape[1])
        if v < vehicles or observed.detected[0, v]
    ]


def _encode_prediction(frame: Frame) -> list[list[list[float]]] | None:
    if frame.prediction is None:
        return None
    x, y = frame.prediction.x[0], frame.prediction.y[0]
    tracked = ~np.isinf(x).any(axis=-1)
    return [_round_points(np.stack(pair, axis=-1)) for pair in zip(x[tracked], y[tracked], strict=True)]


def _round_points(points: Any) -> list[list[float]]:
    return [[_round(x), _round(y)] for x, y in points]


def _count_numbers(entries: Sequence[Any]) -> int:
    return sum(int(np.size(entry)) for entry in entries if entry is not None)


def _round(value: Any, digits: int = 2) -> float:
    return round(float(np.nan_to_num(value)), digits)  # JSON has no NaN
