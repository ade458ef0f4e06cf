"""Time that an estimate still takes, in words, from the forecast of its cost and its pace so far."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from avrare.base.number_format import format_clock
from avrare.estimation.plan.cost_forecast import CostForecast
from avrare.estimation.plan.plan import Info


@dataclass
class TimeLeft:
    """Time left of one estimate.

    The start of workers and the first compilation belong to the first chunk. Once as much time again has
    passed, the pace is that of the rollouts after it.

    Attributes:
        steady: Leave the first chunk out of the pace; not after a resumption: old chunks arrive at once.
        first: Seconds and state at the first chunk.
    """

    steady: bool = True
    first: tuple[float, Info] | None = field(default=None, init=False)

    def see(self, info: Info, seconds: float) -> None:
        """Remember the first chunk."""
        if self.first is None and info.rollouts:
            self.first = seconds, info

    def most(self, info: Info, seconds: float) -> float:
        """Return the most seconds left; 0 where nothing is known."""
        left = self._range(info, seconds)
        return left[1] if left is not None else 0.0

    def words(self, info: Info, seconds: float) -> list[str]:
        """Return ``2:30 left``, or bounds with their source; before it the rest of a long stage."""
        words, forecast = [], _forecast(info)
        clocked = forecast is not None and (info.goal or forecast.kind == "seconds")
        if info.stage_rows and info.rollouts and not clocked:
            rest = (info.stage_rows - info.stage_done) * self._pace("rollouts", info, seconds)
            if rest >= 5.0:  # a shorter stage needs no clock
                words.append(f"stage {info.stage_done}/{info.stage_rows}, {format_clock(rest)} left in it")
        if forecast is not None and (left := self._range(info, seconds)) is not None:
            given = f" ({forecast.given})" if forecast.given else ""
            words.append(f"{_clock_range(*left)} left{given}")
        return words

    def _range(self, info: Info, seconds: float) -> tuple[float, float] | None:
        forecast = _forecast(info)
        if forecast is None or seconds <= 0.0 or not info.rollouts:
            return None
        done = _amount(forecast.kind, info, seconds)
        if done <= 0.0 or forecast.most <= done:
            return None
        pace = self._pace(forecast.kind, info, seconds)
        return max(forecast.least - done, 0.0) * pace, (forecast.most - done) * pace

    def _pace(self, kind: str, info: Info, seconds: float) -> float:
        """Return the seconds that one of ``kind`` takes."""
        if self.steady and self.first is not None:
            began, before = self.first
            amount = _amount(kind, info, seconds) - _amount(kind, before, began)
            if seconds >= 2.0 * began and amount > 0.0:
                return (seconds - began) / amount
        return seconds / _amount(kind, info, seconds)


def _forecast(info: Info) -> CostForecast | None:
    return CostForecast("rollouts", info.goal, info.goal) if info.goal else info.forecast


def _amount(kind: str, info: Info, seconds: float) -> float:
    return {"rollouts": info.rollouts, "steps": info.steps, "seconds": seconds}[kind]


def _clock_range(least: float, most: float) -> str:
    low, high = format_clock(least), format_clock(most)
    if low == high:
        return low
    if math.isinf(most):
        return f"at least {low}"
    return f"{low} .. {high}" if least > 0.0 else f"up to {high}"
