"""Charts of a replayed drive beside its animation, on the same clock.

When it was lost, what perception got wrong in metres, distance, speed, acceleration and time to collision.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.driving.geometry import ego_rectangle, other_rectangles, signed_distance
from avrare.protocols import Bools, Floats
from avrare.report.html.line_chart import LineChart, Scale, make_linear_scale, render_legend
from avrare.report.html.markup import Markup, tag
from avrare.report.html.stored_rollouts import MonitoredRollout

_HEIGHT = 96
_MAX_VEHICLES = 3
_LONGEST = 10.0
"""Time to collision above this is not drawn [s]."""
_FEW = 0.25
"""Shown of a scale beyond the largest error: a chart of centimetres is no chart of metres [m]."""


def make_time_axis(result: MonitoringResult) -> tuple[Floats, Scale]:
    """Return the times of the samples and an axis on which each is as wide as its pixel in a strip."""
    times, half = result.recording.times, 0.5 * result.recording.dt
    return times, Scale(float(times[0]) - half, float(times[-1]) + half)


class DriveCharts:
    """Charts over time of one replayed rollout, with the moments at which it was lost and violated."""

    def __init__(self, rollout: MonitoredRollout, marked: Sequence[str]) -> None:
        assert rollout.result is not None
        self.rollout, self.result = rollout, rollout.result
        self.times, self.x = make_time_axis(rollout.result)
        names = () if self.result.recording.scene is None else self.result.recording.scene.names
        order = sorted(range(len(names)), key=lambda v: names[v] not in marked)
        self.vehicles = [(v, names[v]) for v in order[:_MAX_VEHICLES]]

    def render(self) -> Markup:
        """Return all charts that this rollout has, and what their marks mean."""
        figures = [self._draw_continuations()]
        if self.rollout.frames:
            figures += [self._draw_errors(v, name) for v, name in self.vehicles]
            figures += [self._draw_distance(), self._draw_speed()]
            figures += [self._draw_acceleration(), self._draw_time_to_collision(), self._draw_jerk()]
        shown = [one for one in figures if one is not None]
        marks = [("line mark lost", "lost")] if self._lost is not None else []
        marks += [("line mark", "violated first")] if self.rollout.violation is not None else []
        key = tag("div", render_legend(*marks), class_="legend") if marks and shown else None
        return tag("div", tag("div", shown, class_="signals"), key)

    @property
    def _lost(self) -> int | None:
        found = self.rollout.continuations
        return None if found is None else found.lost

    def _finish(self, chart: LineChart, caption: str, *key: tuple[str, str]) -> Markup:
        for sample, style in ((self._lost, "mark lost"), (self.rollout.violation, "mark")):
            if sample is not None:
                chart.draw_mark(float(self.times[sample]), style)
        return chart.render(caption, render_legend(*key) if key else None, height=_HEIGHT)

    def _draw_continuations(self) -> Markup | None:
        found = self.rollout.continuations
        if found is None:
            return None
        at = found.steps >= 0
        steps, values = found.steps[at], found.robustness[at]
        title = "Robustness of the drive if the noise ended at each time"
        chart = LineChart(self.x, make_linear_scale(values.tolist(), zero=True), title, over_time=True)
        chart.fill_below_zero(self.times[steps], values)
        chart.draw_zero()
        chart.draw_line(self.times[steps], values, "accent")
        return self._finish(chart, "Robustness if the noise ended here")

    def _draw_errors(self, v: int, name: str) -> Markup | None:
        seen = [one.observation for one in self.rollout.frames]
        if not any(one is not None for one in seen):
            return None
        others = [one.world.others for one in self.rollout.frames]
        along, across = (
            np.array([
                np.nan if one is None else getattr(one, key)[0, v] - getattr(true, key)[0, v]
                for one, true in zip(seen, others, strict=True)
            ])
            for key in ("x", "y")
        )  # fmt: skip
        missed = np.array([one is not None and not one.detected[0, v] for one in seen])
        finite = np.concatenate([part[np.isfinite(part)] for part in (along, across)])
        chart = LineChart(
            self.x, make_linear_scale([*finite.tolist(), -_FEW, _FEW], zero=True),
            f"Error of the observed position of {name}", over_time=True,
        )  # fmt: skip
        self._shade(chart, missed)
        chart.draw_zero()
        chart.draw_line(self.times, along, "accent")
        chart.draw_line(self.times, across, "second")
        key = [("line accent", "ahead"), ("line second", "left")]
        key += [("box missed", "missed")] if missed.any() else []
        return self._finish(chart, f"Error of {name} as seen [m]", *key)

    def _shade(self, chart: LineChart, where: Bools) -> None:
        half = 0.5 * self.result.recording.dt
        edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
        for first, end in edges.reshape(-1, 2):
            ends = np.array([self.times[first] - half, self.times[end - 1] + half])
            chart.fill_band(ends, np.full(2, chart.y.low), np.full(2, chart.y.high), "missed")

    def _draw_distance(self) -> Markup | None:
        if not self.vehicles:
            return None
        v, name = self.vehicles[0]
        values = self._distance(v)
        chart = LineChart(
            self.x, make_linear_scale(values.tolist(), zero=True), f"Distance to {name}", over_time=True
        )
        chart.fill_below_zero(self.times, values)
        chart.draw_zero()
        chart.draw_line(self.times, values, "accent")
        return self._finish(chart, f"Distance to {name} [m]")

    def _distance(self, v: int) -> Floats:
        scene = self.result.recording.scene
        assert scene is not None
        found = [
            signed_distance(ego_rectangle(one.world.ego, scene), other_rectangles(one.world.others, scene))[
                0, v
            ]
            for one in self.rollout.frames
        ]
        return np.array(found, dtype=np.float64)

    def _draw_speed(self) -> Markup:
        ego = np.array([float(one.world.ego.speed[0]) for one in self.rollout.frames])
        lines, key = [(ego, "accent")], [("line accent", "ego")]
        if self.vehicles:
            v, name = self.vehicles[0]
            lines.append(
                (np.array([float(one.world.others.speed[0, v]) for one in self.rollout.frames]), "second")
            )
            key.append(("line second", name))
        chart = LineChart(
            self.x,
            make_linear_scale(np.concatenate([one for one, _ in lines]).tolist()),
            "Speed",
            over_time=True,
        )
        for values, style in lines:
            chart.draw_line(self.times, values, style)
        return self._finish(chart, "Speed [m/s]", *key)

    def _draw_acceleration(self) -> Markup:
        signals = self.result.recording.signals
        ego = np.array([float(one.world.ego.acceleration[0]) for one in self.rollout.frames])
        lines, key = [(ego, "accent")], [("line accent", "forward")]
        if "lateral_acceleration" in signals:
            lines.append((np.asarray(signals["lateral_acceleration"], dtype=np.float64), "second"))
            key.append(("line second", "to the left"))
        scale = make_linear_scale(np.concatenate([one for one, _ in lines]).tolist(), zero=True)
        chart = LineChart(self.x, scale, "Acceleration of the ego", over_time=True)
        chart.draw_zero()
        for values, style in lines:
            chart.draw_line(self.times, values, style)
        return self._finish(chart, "Acceleration of the ego [m/s²]", *key)

    def _draw_time_to_collision(self) -> Markup | None:
        values = self.result.recording.signals.get("time_to_collision")
        caption = "Time to collision [s]"
        if values is None:
            if not self.vehicles:
                return None
            v, name = self.vehicles[0]
            distance = self._distance(v)
            closing = -np.gradient(distance, self.times) if len(distance) > 1 else np.zeros(len(distance))
            values = np.divide(distance, closing, out=np.full(len(distance), np.inf), where=closing > 0.0)
            caption = f"Distance over closing speed, {name} [s]"
        values = np.asarray(values, dtype=np.float64)
        near = np.where(values <= _LONGEST, values, np.nan)
        if not np.isfinite(near).any():
            return None
        chart = LineChart(
            self.x, make_linear_scale([*near.tolist(), 0.0], zero=True), caption, over_time=True
        )
        chart.draw_zero()
        chart.draw_line(self.times, near, "accent")
        return self._finish(chart, caption)

    def _draw_jerk(self) -> Markup | None:
        values = self.result.recording.signals.get("jerk")
        if values is None:
            return None
        values = np.asarray(values, dtype=np.float64)
        chart = LineChart(
            self.x, make_linear_scale(values.tolist(), zero=True), "Jerk of the ego", over_time=True
        )
        chart.draw_zero()
        chart.draw_line(self.times, values, "accent")
        return self._finish(chart, "Jerk of the ego [m/s³]")
