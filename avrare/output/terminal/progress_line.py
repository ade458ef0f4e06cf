"""Progress display of a running estimate, with the time that it still takes."""

from __future__ import annotations

import math
import os
import sys
import time
from dataclasses import dataclass, field

from rich.console import Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from avrare.base.number_format import format_clock
from avrare.base.visible_text import spell_line
from avrare.estimation.plan.plan import CostForecast, Info
from avrare.estimation.result.intervals import clopper_pearson
from avrare.output.terminal.console import Mode, make_console
from avrare.rollout.executors.interruption import Stopping
from avrare.rollout.problem import Problem


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
            basis = f" ({forecast.given})" if forecast.given else ""
            words.append(f"{_clock_range(*left)} left{basis}")
        return words

    def _range(self, info: Info, seconds: float) -> tuple[float, float] | None:
        forecast = _forecast(info)
        if forecast is None or seconds <= 0.0 or not info.rollouts:
            return None
        amount = _amount(forecast.kind, info, seconds)
        if amount <= 0.0 or forecast.most <= amount:
            return None
        pace = self._pace(forecast.kind, info, seconds)
        return max(forecast.least - amount, 0.0) * pace, (forecast.most - amount) * pace

    def _pace(self, kind: str, info: Info, seconds: float) -> float:
        """Return the seconds per unit of ``kind``."""
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


_PLAIN_INTERVAL = 15.0  # seconds between two lines where nothing can be redrawn


class Progress:
    """Live lines on stderr; occasional plain lines if stderr is not a terminal; or nothing.

    Without a confidence no interval is shown: the estimate is not a share of rollouts. ``stop``
    returns whether the user asked to stop; its own message is silenced while the lines are live.
    """

    def __init__(
        self,
        label: str,
        problem: Problem,
        mode: Mode = "auto",
        confidence: float | None = None,
        stop: Stopping | None = None,
    ) -> None:
        self.label = label
        self.problem = problem
        self.mode, self.confidence, self.stop = mode, confidence, stop
        self.info = Info()
        self.began = self.printed = time.monotonic()
        self._left = TimeLeft()
        self._live: Live | None = None

    def __enter__(self) -> Progress:
        if self.mode == "auto" and _can_redraw():
            # Redrawn by the clock, so that the time runs on between slow chunks.
            self._live = Live(
                console=make_console(stderr=True, soft_wrap=False),
                get_renderable=self._view,
                refresh_per_second=4,
                transient=True,
            )
            self._live.start()
            self._set_silent(True)
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._set_silent(False)
            self._live.stop()
            self._live = None

    def resume(self, seconds: float) -> None:
        """Go on after an interruption: ``seconds`` were spent before it."""
        self.began -= seconds
        self._left = TimeLeft(steady=not seconds)

    def see(self, info: Info) -> bool:
        """Take the newest state; return whether it is the first one, of an estimate that takes long."""
        first, seconds = not self.info.rollouts, time.monotonic() - self.began
        self.info = info
        self._left.see(info, seconds)
        # After a resumption the first chunk is one of many that arrive at once, and says nothing of the pace.
        return first and self._left.steady and self._left.most(info, seconds) >= _PLAIN_INTERVAL

    def __call__(self, info: Info) -> None:
        """Show the newest state."""
        foretells, now = self.see(info), time.monotonic()
        due = foretells or now - self.printed >= _PLAIN_INTERVAL
        if self.mode != "quiet" and self._live is None and due:
            self.printed = now
            print(spell_line(self.line(info, now - self.began)), file=sys.stderr, flush=True)

    def line(self, info: Info, seconds: float) -> str:
        """Return ``safe_distance  level 7  gamma 0.42  p≈3.1e-05  survivors 34/100  ...``."""
        goal = f"/{info.goal}" if info.goal else ""
        words = [self.label, *self._estimate(info), f"rollouts {info.rollouts}{goal}"]
        return "  ".join([*words, *self._pace(info, seconds), *_counters(info)])

    def _set_silent(self, silent: bool) -> None:
        if self.stop is not None:
            self.stop.silent = silent

    def _estimate(self, info: Info) -> list[str]:
        words = [f"level {info.stage}"] if info.stage else []
        if info.level is not None:
            words.append(f"gamma {self.problem.gamma(info.level):.3g}")
        if info.probability:  # 0 only means that no run has finished
            words.append(f"p≈{info.probability:.2g}")
        elif info.probability is None and self.confidence is not None and info.rollouts:
            words.append(self._failure_share(info, self.confidence))
        if info.survivors is not None:
            words.append(f"survivors {info.survivors}/{info.particles}")
        return words

    def _failure_share(self, info: Info, confidence: float) -> str:
        any_of = " any" if len(self.problem.names) > 1 else ""
        share = f"p{any_of} {info.failures / info.rollouts:.2g}"
        if info.goal is None:  # the failures decide when to stop: the interval would not hold
            return share
        low, high = clopper_pearson(info.failures, info.rollouts, confidence, errors=info.errors)
        return f"{share} ({low:.2g} .. {high:.2g})"

    def _pace(self, info: Info, seconds: float) -> list[str]:
        if seconds <= 0.0 or not info.rollouts:
            return []
        return [f"{info.rollouts / seconds:.1f}/s", *self._left.words(info, seconds)]

    def _view(self) -> Group:
        info, seconds = self.info, time.monotonic() - self.began
        goal = f" of {info.goal:,}" if info.goal else ""
        count = Text(f"{info.rollouts:,}{goal} rollouts" if info.rollouts else "starting", no_wrap=True)
        bar = [ProgressBar(info.goal, min(info.rollouts, info.goal), width=24)] if info.goal else []
        rate, *left = self._pace(info, seconds) or [""]
        remaining = left if info.goal else []
        pace = "   ".join([format_clock(seconds), rate, *remaining])
        advance = Table.grid(padding=(0, 2, 0, 0))
        advance.add_row(*bar, count, Text(pace, style="dim", no_wrap=True))
        head = Text(self.label, style="bold", no_wrap=True, overflow="ellipsis")
        estimate = Text("   ".join([*self._estimate(info), *_counters(info)]))
        below = [Text("   ".join(left), style="dim")] if left and not remaining else []
        rows: list[RenderableType] = [head, advance, *below, estimate]
        if self.stop is not None and self.stop():
            text = "stopping after the current chunk; press Ctrl-C again to stop at once"
            rows.append(Text(text, style="yellow"))
        return Group(*rows)


def _counters(info: Info) -> list[str]:
    counts = [(name.replace("_", " "), n) for name, n in info.counts.items() if n and name != "solves"]
    return [f"{name} {n}" for name, n in [("failures", info.failures), ("errors", info.errors), *counts]]


def _can_redraw() -> bool:  # stderr is a terminal that can move its cursor, whatever is set about colours
    return sys.stderr.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", "")
