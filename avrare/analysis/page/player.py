"""Player of a stored rollout: animation, charts on the same clock, strips of predicates and noise."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import JsonValue

from avrare.analysis.failures.severity import measure_severity
from avrare.analysis.monitor.monitoring import MonitoringResult, list_vehicle_names, select_inputs, summarise
from avrare.analysis.page.drive_charts import DriveCharts, make_time_axis
from avrare.analysis.page.model import Player, Strip, Strips
from avrare.analysis.page.stored_rollouts import MonitoredRollout, StoredRollout
from avrare.base.chart import Chart, make_linear_scale
from avrare.base.errors import FormulaError
from avrare.base.number_format import format_robustness
from avrare.driving.lanes import list_lanes, list_markings
from avrare.logic.syntax import nodes
from avrare.logic.syntax.printer import to_text
from avrare.protocols import Floats, Specification
from avrare.rollout.problem import Problem
from avrare.rollout.replay import Frame
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.drawn_start import SIGNAL

_MAX_ROWS = 24


def build_player(rollout: MonitoredRollout, problem: Problem, folder: Path | None = None) -> Player:
    """Return everything about one rollout, synchronised by one clock.

    ``folder`` is that of the run, for the command that replays it.
    """
    stored, result = rollout.stored, rollout.result
    anchor = "" if stored.index is None else name_rollout(stored.specification, stored.index)
    if result is None:
        return Player(stored.title, _describe_rollout(stored), anchor, problem=rollout.problem)
    decisive = [sample for sample in (result.first, result.worst) if sample is not None]
    marked = sorted({name for sample in decisive for name in sample.vehicles.values()})
    recording, start = result.recording, _select_start(result)
    charts = DriveCharts(rollout, marked)
    figures = charts.draw()
    return Player(
        stored.title,
        _describe_rollout(stored),
        anchor,
        sentence=typeset_minus(summarise(result)),
        severity=_describe_severity(result),
        lost=_describe_lost(rollout),
        difference=_describe_difference(stored, result),
        drawn=_list_drawn(result),
        start=start,
        samples=recording.samples,
        clock=float(recording.time(start)),
        top_view="" if recording.scene is None else f"Top view of the rollout: {summarise(result)}",
        view=_tabulate_view(result, rollout.frames, marked),
        signals=_draw_signals(result) if recording.scene is None else (),
        charts=figures,
        marks=charts.list_marks() if figures else (),
        robustness=_draw_robustness(result),
        predicates=draw_predicates(problem.monitor(result.name), result),
        noise=draw_noise(problem, stored.tape, stored.failed),
        command=_write_command(stored, folder),
    )


def name_rollout(specification: str, index: int) -> str:
    """Return the anchor of a stored failure in the report."""
    return f"failure-{specification}-{index}"


def _describe_severity(result: MonitoringResult) -> str:
    severity = measure_severity(result)
    return "" if severity is None else f"The {severity.describe()}."


def _describe_lost(rollout: MonitoredRollout) -> str:
    if rollout.not_continued:
        return f"When it was lost could not be found: {rollout.not_continued}."
    if rollout.continuations is None:
        return ""
    text = rollout.continuations.describe(rollout.violation)
    return f"{text[0].upper()}{text[1:]}."


def _write_command(stored: StoredRollout, folder: Path | None) -> str:
    if folder is None or stored.index is None:
        return ""
    words = ["avrare", "replay", "--run", str(folder), "--specification", stored.specification]
    return shlex.join([*words, "--failure", str(stored.index), "--lost"])


def _list_drawn(result: MonitoringResult) -> tuple[tuple[str, str], ...]:
    signals = result.recording.signals
    drawn = {name.removeprefix(SIGNAL): signals[name] for name in signals if name.startswith(SIGNAL)}
    return tuple((name.replace("_", " "), f"{values[0]:.4g}") for name, values in drawn.items())


def typeset_minus(text: str) -> str:
    """Replace the hyphens before numbers by minus signs."""
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)


def _describe_rollout(stored: StoredRollout) -> str:
    expected = math.sqrt(stored.tape.size)
    robustness = typeset_minus(format_robustness(stored.robustness))
    return f"robustness {robustness} · norm of the noise {stored.norm:.3g} (random rollouts: {expected:.3g})"


def _describe_difference(stored: StoredRollout, result: MonitoringResult) -> str:
    now, then = result.robustness, stored.robustness
    if now == then:
        return ""
    return (
        f"Its robustness is now {typeset_minus(f'{now:.9g}')}, not {typeset_minus(f'{then:.9g}')} as "
        "stored: the version or the machine differs."
    )


def _select_start(result: MonitoringResult) -> int:
    """Return the sample at which the player opens: three seconds before what it is shown for."""
    decisive = result.first or result.worst
    before = round(3.0 / result.recording.dt)  # the player opens 3 s before the failure
    return max(decisive.sample - before, 0) if decisive is not None else 0


def _draw_signals(result: MonitoringResult) -> tuple[Chart, ...]:
    # scalar ones, those of the formula first
    scalar = [name for name, values in result.recording.signals.items() if np.ndim(values) == 1]
    chosen = sorted(scalar, key=lambda name: name not in result.formula)[:12]
    times, x = make_time_axis(result)
    charts = []
    for name in chosen:
        values = np.asarray(result.recording.signals[name], dtype=np.float64)
        title = f"Signal {name} over time"
        chart = Chart(x, make_linear_scale(values.tolist()), title, caption=name, height=84, over_time=True)
        charts.append(chart.line(times, values, "accent"))
    return tuple(charts)


def _draw_robustness(result: MonitoringResult) -> Chart:
    times, x = make_time_axis(result)
    values = result.prefix if result.body is None else result.body
    entries = [("line dashed", "of the samples so far"), ("box violated", "violated")]
    if result.body is not None:
        entries.insert(0, ("line accent", "at each sample"))
    chart = Chart(
        x,
        make_linear_scale([*values.tolist(), *result.prefix.tolist()], zero=True),
        f"Robustness over time, least {format_robustness(result.robustness)}",
        caption="Robustness",
        x_label="time [s]",
        legend=tuple(entries),
        height=150,
        over_time=True,
    )
    chart = chart.below_zero(times, values).zero()
    if result.body is not None:
        chart = chart.line(times, result.body, "accent")
    chart = chart.line(times, result.prefix, "dashed")
    for decisive in (result.first, result.worst):
        if decisive is not None and math.isfinite(decisive.robustness):
            at = np.array([decisive.sample])
            chart = chart.dots(times[at], values[at], "violated" if result.violated else "accent")
    return chart


def _tabulate_view(
    result: MonitoringResult, frames: Sequence[Frame], marked: Sequence[str]
) -> dict[str, JsonValue]:
    # Positions are in metres, to the centimetre.
    recording = result.recording
    content: dict[str, Any] = {"dt": recording.dt, "samples": recording.samples}
    scene = recording.scene
    if scene is None or not frames:
        return content
    road = scene.road
    content["road"] = {
        "lanes": list(road.lane_centres),
        "width": road.lane_width,
        "ramp": [*road.access_ramp, *road.shoulder, *road.opposing],
        "borders": [_round_points((lane.stations, lane.right, lane.left)) for lane in list_lanes(road)],
        "lines": [[*_round_points((line.x, line.y)), line.inner] for line in list_markings(road)],
    }
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
    plans = [None if frame.plan is None else _round_points(frame.plan[:, :2]) for frame in frames]
    predictions = [_encode_prediction(frame) for frame in frames]
    # a longer rollout is shown without them
    if _count_numbers(plans) + _count_numbers(predictions) <= 60_000:
        content |= {"plan": plans, "predicted": predictions}
    return content


def _encode_trajectory(
    frames: Sequence[Frame], who: str, at: int | tuple[int, int]
) -> dict[str, list[float]]:
    vehicles = [getattr(frame.world, who) for frame in frames]
    fields = (("x", "x", 2), ("y", "y", 2), ("h", "heading", 4), ("v", "speed", 2))
    series = {
        key: [_round(getattr(vehicle, field)[at], digits) for vehicle in vehicles]
        for key, field, digits in fields
    }
    # Between samples the player turns a vehicle by the difference: a half turn is passed without a jump.
    return {**series, "h": [_round(heading, 4) for heading in np.unwrap(series["h"])]}


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


def _round_points(points: Iterable[Iterable[float]] | Floats) -> list[list[float]]:
    return [[_round(value) for value in row] for row in points]


def _count_numbers(entries: Sequence[list[list[float]] | list[list[list[float]]] | None]) -> int:
    return sum(int(np.size(entry)) for entry in entries if entry is not None)


def _round(value: float, digits: int = 2) -> float:
    return round(float(np.nan_to_num(value)), digits)  # JSON has no NaN


def draw_predicates(specification: Specification, result: MonitoringResult) -> Strips | None:
    """Return a strip for each predicate that changes over time; None if there are none."""
    predicates = evaluate_predicates(specification, result)
    changing = {text: values for text, values in predicates.items() if len(np.unique(values)) > 1}
    if not changing:
        return None
    rows = []
    for text, values in islice(changing.items(), _MAX_ROWS):
        finite = np.abs(values[np.isfinite(values)])
        largest = float(finite.max()) if len(finite) and finite.max() > 0.0 else 1.0
        description = f"{text}: holds at {int((values > 0).sum())} of {len(values)} samples"
        rows.append(Strip(text, description, shade(values[None], largest), 0.3, 14))
    hidden, constant = len(changing) - len(rows), len(predicates) - len(changing)
    note = f"; {constant} constant ones are not shown" if constant else ""
    note += f"; {hidden} more are not shown" if hidden > 0 else ""
    key = ("box positive", "holds"), ("box negative", "does not hold")
    return Strips("Predicates", tuple(rows), key, f"darker: further from the bound{note}")


def draw_noise(problem: Problem, tape: Floats, failed: bool) -> Strips | None:
    """Return the strips of a noise tape (steps + 1, noise_size); None for a system without noise."""
    if not tape.shape[1]:
        return None
    rows = []
    groups = _group_channels(problem, tape.shape[1])
    for label, first, last in groups[:_MAX_ROWS]:
        channels = tape[:, first:last].T
        description = f"Noise of {label}, {channels.shape[0]} channels over {channels.shape[1]} steps, up to "
        description += f"{np.abs(channels).max():.2f} standard deviations"
        # standard deviations drawn fully opaque
        rows.append(Strip(label, description, shade(channels, 3.0), 0.0, max(11 * len(channels), 14)))
    hidden = len(groups) - len(rows)
    key = ("box positive", "+3 standard deviations"), ("box negative", "−3")
    note = f"{hidden} more rows are not shown" if hidden > 0 else "a row for each channel"
    caption = "Noise that caused the failure" if failed else "Noise"
    return Strips(caption, tuple(rows), key, note)


def evaluate_predicates(specification: Specification, result: MonitoringResult) -> dict[str, Floats]:
    """Map the predicates of a formula, in its order, to their robustness (T,); none without a formula.

    A variable stands for the vehicle that decides; without one there is a series for each vehicle.
    """
    formula = specification.formula
    if formula is None:
        return {}
    try:
        values = formula.parts(select_inputs(specification, result.recording))
    except FormulaError:
        return {}
    names = list_vehicle_names(specification, result.recording)
    decisive = result.first or result.worst
    chosen = decisive.vehicles if decisive is not None else {}
    rows: dict[str, Floats] = {}
    for node, quantifiers in _list_predicates(formula.node, ()):
        array = values[to_text(node)][0]
        for label, row in select_rows(to_text(node), array, quantifiers, names, chosen):
            rows.setdefault(label, row)
    return rows


def _list_predicates(
    node: nodes.Node, outer: tuple[nodes.Quantifier, ...]
) -> Iterator[tuple[nodes.Node, tuple[nodes.Quantifier, ...]]]:
    # each with the quantifiers around it
    inner = (*outer, node) if isinstance(node, nodes.Quantifier) else outer
    children = nodes.children(node)
    if not children:
        yield node, outer
    for child in children:
        yield from _list_predicates(child, inner)


def select_rows(
    predicate: str,
    array: Floats,
    quantifiers: Sequence[nodes.Quantifier],
    names: Sequence[str],
    chosen: Mapping[str, str],
) -> Iterator[tuple[str, Floats]]:
    """Yield a predicate with its values (T,) for each choice of vehicles.

    ``array`` (T, ...) has an axis for each quantifier around the predicate. ``chosen`` maps variables to the
    vehicles that decide; for other variables there is a row for each of the vehicles ``names``.
    """
    sizes = array.shape[1:]
    axes = []
    for quantifier, size in zip(quantifiers, sizes, strict=False):
        vehicle = chosen.get(quantifier.variable)
        members = list(names) if len(names) == size else [str(k) for k in range(size)]
        chosen_members = [members.index(vehicle)] if vehicle in members and size > 1 else range(size)
        axes.append([(quantifier.variable, members[k] if size > 1 else None, k) for k in chosen_members])
    for choice in product(*axes):
        bound = {variable: member for variable, member, _ in choice if member is not None}
        words = re.split(r"\b([A-Za-z_]\w*)\b", predicate)
        label = "".join(bound.get(word, word) for word in words)
        yield label, np.moveaxis(array, 0, -1)[tuple(k for _, _, k in choice)]


def _group_channels(problem: Problem, size: int) -> list[tuple[str, int, int]]:
    # (label, first, last + 1): the channels of draws come first, of the simulator, then of the perception
    # model, which are taken to be ordered by vehicle if there are equally many for each.
    loop = problem.system
    if not isinstance(loop, ClosedLoop):
        return [("simulator", 0, size)]
    drawn, world = loop.world_noise - loop.simulator.noise_size, loop.world_noise
    groups = [("draws, at the start", 0, drawn)] if drawn else []
    label = loop.noise_names[drawn] if loop.noise_names and world == drawn + 1 else "simulator"
    groups += [(label, drawn, world)] if world > drawn else []
    names = problem.scene.names if problem.scene is not None else ()
    each, rest = divmod(size - world, max(len(names), 1))
    if size == world:
        return groups
    if not names or rest:
        return [*groups, ("perception", world, size)]
    return groups + [
        (f"perception of {name}", world + v * each, world + (v + 1) * each) for v, name in enumerate(names)
    ]


def shade(values: Floats, largest: float) -> tuple[tuple[float, ...], ...]:
    """Return values (rows, columns) as signed shares of ``largest``, at most 1; 0 for NaN."""
    with np.errstate(invalid="ignore"):
        shares = np.nan_to_num(np.clip(values / largest, -1.0, 1.0))
    return tuple(tuple(row) for row in shares.tolist())
