"""One rollout on the page: top view or signals, robustness over time, predicates, and the noise behind it."""

from __future__ import annotations

import math
import re

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.protocols import Floats
from avrare.record.trace_score import Score
from avrare.report.html import pixels
from avrare.report.html.drives import Drive, Shown
from avrare.report.html.markup import Markup, data, tag
from avrare.report.html.parts import predicates
from avrare.report.html.plot import Plot, cursor, key
from avrare.report.html.road import film
from avrare.report.html.scales import Scale, linear
from avrare.report.monitoring import number, sentence

_MOST_ROWS = 24
"""Predicates, or channels of noise, that are drawn."""
_MOST_SIGNALS = 12
_LOUD = 3.0
"""Size of a standard normal number that is drawn fully opaque."""


def player(drive: Drive, scenario: BuildableScenario, opened: bool) -> Markup:
    """Everything about one rollout, with one clock for all of it."""
    summary = tag("summary", tag("h3", drive.shown.title), tag("span", _facts(drive.shown), class_="muted"))
    if drive.score is None:
        return tag("details", summary, tag("p", f"It cannot be shown: {drive.trouble}."), open=opened)
    score = drive.score
    marked = sorted({name for one in (score.first, score.worst) if one for name in one.vehicles.values()})
    return tag(
        "details", summary,
        tag("p", minus(sentence(score)), class_="sentence"),
        _differs(drive),
        tag(
            "div", _stage(score), data(film(drive, marked)), _robustness(score),
            _predicates(scenario, score), _noise(drive.shown, scenario, score),
            class_="drive", data_start=_start(score),
        ),
        open=opened,
    )  # fmt: skip


def _facts(shown: Shown) -> str:
    typical = math.sqrt(shown.tape.size)
    return (
        f"robustness {minus(number(shown.robustness))} · noise of length {shown.norm:.3g}, "
        f"typical is {typical:.3g}"
    )


def _differs(drive: Drive) -> Markup | None:
    if not drive.differs:
        return None
    assert drive.score is not None
    now, then = drive.score.robustness, drive.shown.robustness
    return tag(
        "p", f"Driven again it has robustness {minus(f'{now:.9g}')}, not {minus(f'{then:.9g}')} as stored: "
        "another version, or another machine.", class_="note",
    )  # fmt: skip


def _start(score: Score) -> int:
    """The moment that is shown first."""
    moment = score.first or score.worst
    return moment.sample if moment is not None else 0


def _stage(score: Score) -> Markup:
    recording = score.recording
    last = recording.samples - 1
    controls = tag(
        "div",
        tag("button", "Play", type="button", class_="play"),
        tag("input", type="range", min=0, max=last, step=1, value=_start(score), aria_label="moment"),
        tag("output", f"{recording.time(_start(score)):.2f} s"),
        tag("button", "1×", type="button", class_="speed", aria_label="speed of playing"),
        class_="controls",
    )  # fmt: skip
    if recording.scene is None:
        return tag("div", _signals(score), controls)
    words = f"Top view of the drive from above: {sentence(score)}"
    legend = key(
        ("car ego", "ego"), ("car other", "others"), ("car culprit", "decides"), ("dot seen", "observed"),
        ("ring", "missed"), ("line accent", "plan"), ("line predicted", "predicted"),
    )  # fmt: skip
    canvas = tag("canvas", words, role="img", aria_label=words, class_="view")
    return tag("div", canvas, tag("div", legend, class_="legend"), controls)


def _time(score: Score) -> tuple[Floats, Scale]:
    """Time [s] of the samples and its axis, on which each sample is as wide as its pixel below."""
    times, half = score.recording.times, 0.5 * score.recording.dt
    return times, Scale(float(times[0]) - half, float(times[-1]) + half)


def _signals(score: Score) -> Markup:
    """Without vehicles: the signals, those that the formula reads first."""
    times, x = _time(score)
    scalar = {name: values for name, values in score.recording.signals.items() if np.ndim(values) == 1}
    figures = []
    for name in sorted(scalar, key=lambda one: one not in score.formula)[:_MOST_SIGNALS]:
        values = np.asarray(scalar[name], dtype=np.float64)
        plot = Plot(x, linear(values.tolist()), f"Signal {name} over time", over_time=True)
        plot.line(times, values, "accent")
        figures.append(plot.render(name, height=84))
    return tag("div", figures, class_="signals")


def _robustness(score: Score) -> Markup:
    times, x = _time(score)
    values = score.prefix if score.body is None else score.body
    shown = [*values.tolist(), *score.prefix.tolist()]
    title = f"Robustness over time, least {number(score.robustness)}"
    plot = Plot(x, linear(shown, zero=True), title, "time [s]", over_time=True)
    plot.below(times, values)
    plot.level(0.0)
    entries = [("line dashed", "so far")]
    if score.body is not None:
        plot.line(times, score.body, "accent")
        entries.insert(0, ("line accent", "at each sample"))
    plot.line(times, score.prefix, "dashed")
    for moment in (score.first, score.worst):
        if moment is not None and math.isfinite(moment.robustness):
            at = np.array([moment.sample])
            plot.dots(times[at], values[at], "broken" if score.broken else "accent")
    entries.append(("box broken", "broken"))
    return tag("div", plot.render("Robustness", key(*entries), height=150), class_="gutter")


def _predicates(scenario: BuildableScenario, score: Score) -> Markup | None:
    everything = predicates(scenario.stack.specifications[score.name], score)
    found = [part for part in everything if len(np.unique(part.values)) > 1]
    if not found:
        return None
    rows = []
    for part in found[:_MOST_ROWS]:
        finite = np.abs(part.values[np.isfinite(part.values)])
        largest = float(finite.max()) if len(finite) and finite.max() > 0.0 else 1.0
        words = f"{part.text}: holds at {int((part.values > 0).sum())} of {len(part.values)} samples"
        rows.append(_strip(part.text, pixels.signed(part.values[None], largest, 0.3), 14, words))
    left, still = len(found) - len(rows), len(everything) - len(found)
    note = f"; {still} that never change are left out" if still else ""
    note += f"; {left} more are not drawn" if left > 0 else ""
    legend = [
        key(("box positive", "holds"), ("box negative", "does not")),
        f"the stronger, the clearer{note}",
    ]
    return tag(
        "figure", tag("figcaption", "What the rule is made of"), rows, tag("div", legend, class_="legend"),
        class_="strips gutter",
    )  # fmt: skip


def _noise(shown: Shown, scenario: BuildableScenario, score: Score) -> Markup | None:
    if not shown.tape.shape[1]:
        return None
    rows = []
    groups = channels(scenario, shown.tape.shape[1])
    for label, first, last in groups[:_MOST_ROWS]:
        part = shown.tape[:, first:last].T
        words = f"Noise of {label}, {part.shape[0]} channels over {part.shape[1]} steps, up to "
        words += f"{np.abs(part).max():.2f} standard deviations"
        rows.append(_strip(label, pixels.signed(part, _LOUD), max(11 * len(part), 14), words))
    left = len(groups) - len(rows)
    legend = [
        key(("box positive", "+3 standard deviations"), ("box negative", "−3")),
        f"{left} more rows are not drawn" if left > 0 else "a row for each channel",
    ]
    caption = "The noise that caused it" if shown.failed else "The noise behind it"
    return tag(
        "figure", tag("figcaption", caption), rows, tag("div", legend, class_="legend"),
        class_="strips gutter",
    )  # fmt: skip


def channels(scenario: BuildableScenario, size: int) -> list[tuple[str, int, int]]:
    """(label, first, last + 1) of the channels of noise that are drawn together.

    The simulator's come first, then the perception's. A perception model with as many for each vehicle has
    them vehicle by vehicle.
    """
    own = int(scenario.stack.loop.simulator.noise_size)
    found = [("simulator", 0, own)] if own else []
    names = scenario.scene.names if scenario.scene is not None else ()
    each, rest = divmod(size - own, max(len(names), 1))
    if size == own:
        return found
    if not names or rest:
        return [*found, ("perception", own, size)]
    return found + [(f"seeing {name}", own + v * each, own + (v + 1) * each) for v, name in enumerate(names)]


def _strip(label: str, uri: str, height: int, words: str) -> Markup:
    picture = tag("img", src=uri, alt=words, style=f"height:{height}px")
    name = tag("div", tag("span", label), class_="name", title=label)
    return tag("div", name, tag("div", picture, cursor(), class_="area"), class_="strip over-time")


def minus(words: str) -> str:
    """With minus signs rather than hyphens before numbers."""
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", words)
