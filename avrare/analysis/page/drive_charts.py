"""Charts of a replayed drive beside its animation, on the same clock.

When it was lost, what perception got wrong in metres, distance, speed, acceleration and time to collision.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.analysis.page.stored_rollouts import MonitoredRollout
from avrare.base.chart import Chart, Scale, make_linear_scale
from avrare.driving.geometry import ego_rectangle, other_rectangles, signed_distance
from avrare.protocols import Bools, Floats


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
        self.vehicles = [(v, names[v]) for v in order[:3]]

    def draw(self) -> tuple[Chart, ...]:
        """Return all charts that this rollout has."""
        figures = [self._draw_continuations()]
        if self.rollout.frames:
            figures += [self._draw_errors(v, name) for v, name in self.vehicles]
            figures += [self._draw_distance(), self._draw_speed()]
            figures += [self._draw_acceleration(), self._draw_time_to_collision(), self._draw_jerk()]
        return tuple(figure for figure in figures if figure is not None)

    def list_marks(self) -> tuple[tuple[str, str], ...]:
        """Return the legend of the moments that the charts mark."""
        marks = [("line mark lost", "lost")] if self._lost is not None else []
        marks += [("line mark", "violated first")] if self.rollout.violation is not None else []
        return tuple(marks)

    @property
    def _lost(self) -> int | None:
        continuations = self.rollout.continuations
        return None if continuations is None else continuations.lost

    def _start(self, caption: str, y: Scale, title: str = "", *legend: tuple[str, str]) -> Chart:
        return Chart(self.x, y, title or caption, caption=caption, legend=legend, height=96, over_time=True)

    def _finish(self, chart: Chart) -> Chart:
        for sample, style in ((self._lost, "mark lost"), (self.rollout.violation, "mark")):
            if sample is not None:
                chart = chart.moment(float(self.times[sample]), style)
        return chart

    def _draw_continuations(self) -> Chart | None:
        continuations = self.rollout.continuations
        if continuations is None:
            return None
        at = (continuations.steps >= 0) & (continuations.steps < len(self.times))
        steps, values = continuations.steps[at], continuations.robustness[at]
        chart = self._start(
            "Robustness if the noise ended here",
            make_linear_scale(values.tolist(), zero=True),
            "Robustness of the drive if the noise ended at each time",
        )
        at_times = self.times[steps]
        return self._finish(chart.below_zero(at_times, values).zero().line(at_times, values, "accent"))

    def _draw_errors(self, v: int, name: str) -> Chart | None:
        observations = [frame.observation for frame in self.rollout.frames]
        if not any(observation is not None for observation in observations):
            return None
        others = [frame.world.others for frame in self.rollout.frames]
        along, across = (
            np.array(
                [
                    np.nan
                    if observation is None
                    else getattr(observation, key)[0, v] - getattr(true, key)[0, v]
                    for observation, true in zip(observations, others, strict=True)
                ]
            )
            for key in ("x", "y")
        )
        missed = np.array(
            [observation is not None and not observation.detected[0, v] for observation in observations]
        )
        finite = np.concatenate([errors[np.isfinite(errors)] for errors in (along, across)])
        key = [("line accent", "ahead"), ("line second", "left")]
        key += [("box missed", "missed")] if missed.any() else []
        margin = 0.25  # centimetres need another chart than metres
        chart = self._start(
            f"Error of {name} as seen [m]",
            make_linear_scale([*finite.tolist(), -margin, margin], zero=True),
            f"Error of the observed position of {name}",
            *key,
        )
        chart = self._shade(chart, missed).zero()
        chart = chart.line(self.times, along, "accent").line(self.times, across, "second")
        return self._finish(chart)

    def _shade(self, chart: Chart, where: Bools) -> Chart:
        half = 0.5 * self.result.recording.dt
        edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
        for first, end in edges.reshape(-1, 2):
            ends = np.array([self.times[first] - half, self.times[end - 1] + half])
            chart = chart.band(ends, np.full(2, chart.y.low), np.full(2, chart.y.high), "missed")
        return chart

    def _draw_distance(self) -> Chart | None:
        if not self.vehicles:
            return None
        v, name = self.vehicles[0]
        values = self._distance(v)
        y = make_linear_scale(values.tolist(), zero=True)
        chart = self._start(f"Distance to {name} [m]", y, f"Distance to {name}")
        return self._finish(chart.below_zero(self.times, values).zero().line(self.times, values, "accent"))

    def _distance(self, v: int) -> Floats:
        scene = self.result.recording.scene
        assert scene is not None
        distances = [
            signed_distance(
                ego_rectangle(frame.world.ego, scene), other_rectangles(frame.world.others, scene)
            )[0, v]
            for frame in self.rollout.frames
        ]
        return np.array(distances, dtype=np.float64)

    def _draw_speed(self) -> Chart:
        ego = np.array([float(frame.world.ego.speed[0]) for frame in self.rollout.frames])
        lines, key = [(ego, "accent")], [("line accent", "ego")]
        if self.vehicles:
            v, name = self.vehicles[0]
            lines.append(
                (np.array([float(frame.world.others.speed[0, v]) for frame in self.rollout.frames]), "second")
            )
            key.append(("line second", name))
        y = make_linear_scale(np.concatenate([speeds for speeds, _ in lines]).tolist())
        chart = self._start("Speed [m/s]", y, "Speed", *key)
        for values, style in lines:
            chart = chart.line(self.times, values, style)
        return self._finish(chart)

    def _draw_acceleration(self) -> Chart:
        signals = self.result.recording.signals
        ego = np.array([float(frame.world.ego.acceleration[0]) for frame in self.rollout.frames])
        lines, key = [(ego, "accent")], [("line accent", "forward")]
        if "lateral_acceleration" in signals:
            lines.append((np.asarray(signals["lateral_acceleration"], dtype=np.float64), "second"))
            key.append(("line second", "to the left"))
        y = make_linear_scale(np.concatenate([values for values, _ in lines]).tolist(), zero=True)
        chart = self._start("Acceleration of the ego [m/s²]", y, "Acceleration of the ego", *key).zero()
        for values, style in lines:
            chart = chart.line(self.times, values, style)
        return self._finish(chart)

    def _draw_time_to_collision(self) -> Chart | None:
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
        near = np.where(values <= 10.0, values, np.nan)  # [s]
        if not np.isfinite(near).any():
            return None
        chart = self._start(caption, make_linear_scale([*near.tolist(), 0.0], zero=True))
        return self._finish(chart.zero().line(self.times, near, "accent"))

    def _draw_jerk(self) -> Chart | None:
        values = self.result.recording.signals.get("jerk")
        if values is None:
            return None
        values = np.asarray(values, dtype=np.float64)
        y = make_linear_scale(values.tolist(), zero=True)
        chart = self._start("Jerk of the ego [m/s³]", y, "Jerk of the ego")
        return self._finish(chart.zero().line(self.times, values, "accent"))
