"""Pictures of kinds of failure: the moment of a typical one from above, and all failures in a plane."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from avrare.report.html.line_chart import LineChart, make_linear_scale, render_legend
from avrare.report.html.markup import Markup, tag
from avrare.report.html.stored_rollouts import MonitoredRollout
from avrare.report.plots.rollout_plot import Frame
from avrare.results.stored_causes import StoredKinds

_BEHIND, _AHEAD = 30.0, 50.0
"""Stretch of road around the ego that is drawn [m]."""
_TRAIL = 3.0
"""Time whose paths are drawn [s]."""
STYLES = 6
"""Colours of kinds; the seventh kind has that of the first."""


def draw_moment(rollout: MonitoredRollout) -> Markup | None:
    """Return the first violation, or the decisive sample, seen from above; None without vehicles."""
    result = rollout.result
    decisive = None if result is None else result.first or result.worst
    if result is None or decisive is None or not rollout.frames or result.recording.scene is None:
        return None
    scene, at = result.recording.scene, decisive.sample
    frame = rollout.frames[at]
    road = scene.road
    half = 0.5 * road.lane_width
    low, high = road.lane_centres[0] - half, road.lane_centres[-1] + half
    begin = float(frame.world.ego.x[0]) - _BEHIND
    parts = [
        tag("rect", x=0, y=_number(-high), width=_BEHIND + _AHEAD, height=_number(high - low), class_="road")
    ]
    for centre in road.lane_centres[:-1]:
        parts.append(tag("path", d=f"M0 {_number(-centre - half)}H{_BEHIND + _AHEAD:g}", class_="lane"))
    first = max(at - round(_TRAIL / result.recording.dt), 0)
    trail = rollout.frames[first : at + 1]
    names = set(decisive.vehicles.values())
    for v, name in enumerate(scene.names):
        style = "decides" if name in names else "other"
        size = float(scene.lengths[v]), float(scene.widths[v])
        parts += _draw_vehicle(trail, "others", (0, v), size, begin, style, name)
    ego = float(scene.ego_length), float(scene.ego_width)
    parts += _draw_vehicle(trail, "ego", (0,), ego, begin, "ego", "ego")
    moment = "first violation" if result.first is not None else "least robustness"
    words = f"The road at {result.recording.time(at):.1f} s, at the {moment}"
    box = f"0 {_number(-high - 2.5)} {_BEHIND + _AHEAD:g} {_number(high - low + 5.0)}"
    return tag("svg", tag("title", words), parts, viewBox=box, role="img", aria_label=words, class_="moment")


def _draw_vehicle(
    trail: Sequence[Frame], who: str, at: tuple[int, ...], size: tuple[float, float], begin: float,
    style: str, name: str,
) -> list[Markup]:  # fmt: skip
    states = [getattr(one.world, who) for one in trail]
    points = [(float(one.x[at]) - begin, -float(one.y[at])) for one in states]
    x, y = points[-1]
    if not -size[0] <= x <= _BEHIND + _AHEAD + size[0]:
        return []
    turn = -math.degrees(float(states[-1].heading[at]))
    length, width = size
    place = f"translate({_number(x)} {_number(y)}) rotate({_number(turn)})"
    body = tag(
        "rect", x=_number(-length / 2), y=_number(-width / 2), width=_number(length), height=_number(width),
        rx=0.4, transform=place, class_=style,
    )  # fmt: skip
    path = "L".join(f"{_number(a)} {_number(b)}" for a, b in points)
    label = tag("text", name, x=_number(x), y=_number(y - width / 2 - 0.5), text_anchor="middle")
    return [tag("path", d=f"M{path}", class_=f"trail {style}"), body, label]


def _number(value: float) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".")


def draw_map(kinds: StoredKinds) -> Markup | None:
    """Return all failures in the plane of their principal components, a colour for each kind."""
    if len(kinds.points) < 3 or len(kinds.points) != len(kinds.labels):
        return None
    points, labels = np.array(kinds.points), np.array(kinds.labels)
    if not np.ptp(points, axis=0).all():
        return None
    x, y = (make_linear_scale(points[:, axis].tolist()) for axis in (0, 1))
    chart = LineChart(x, y, f"{len(points)} failures in the plane of their two principal components")
    numbers = sorted(set(labels.tolist()))
    for number in numbers:
        chosen = points[labels == number]
        chart.draw_dots(chosen[:, 0], chosen[:, 1], f"kind-{number % STYLES}")
    key = render_legend(*((f"dot kind-{number % STYLES}", f"kind {number + 1}") for number in numbers))
    figure = chart.render("The failures: near ones are alike", key, height=140)
    return Markup(figure.replace('<figure class="chart">', '<figure class="chart bare">', 1))
