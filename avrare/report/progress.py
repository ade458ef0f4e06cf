"""What a person sees while an estimate is under way."""

from __future__ import annotations

import math
import os
import sys
import time
from typing import Literal

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from avrare.estimation.intervals import clopper_pearson
from avrare.estimation.plan import Info
from avrare.execute.stopping import Stopping
from avrare.rollout.problem import Problem

Mode = Literal["auto", "plain", "quiet"]
_PLAIN_INTERVAL = 15.0
"""Seconds between two lines where nothing can be redrawn."""
_LONG = 359_999
"""Seconds that are as good as for ever."""


class Progress:
    """A few live lines on stderr; one plain line now and then where stderr is no terminal; or nothing.

    Args:
        label: What is being estimated.
        problem: For the meaning of its levels.
        mode: "auto": live on a terminal; "plain": lines without control characters; "quiet": nothing.
        confidence: Of the interval that is shown; None: the estimate is not failures over simulations.
        stop: Tells whether an end was asked for; while lines are live, they say so and it need not.
    """

    def __init__(
        self, label: str, problem: Problem, mode: Mode = "auto", confidence: float | None = None,
        stop: Stopping | None = None,
    ) -> None:  # fmt: skip
        self.label = label
        self.problem = problem
        self.mode, self.confidence, self.stop = mode, confidence, stop
        self.info = Info()
        self.began = self.printed = time.monotonic()
        self._live: Live | None = None

    def __enter__(self) -> Progress:
        if self.mode == "auto" and _redraws():
            # Redrawn by the clock, not by the chunks: with slow ones the time goes on, and one sees it run.
            self._live = Live(
                console=Console(stderr=True), get_renderable=self._view, refresh_per_second=4, transient=True
            )
            self._live.start()
            self._hush(True)
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._hush(False)
            self._live.stop()
            self._live = None

    def __call__(self, info: Info) -> None:
        """Take the newest state."""
        self.info = info
        now = time.monotonic()
        if self.mode != "quiet" and self._live is None and now - self.printed >= _PLAIN_INTERVAL:
            self.printed = now
            print(self.line(info, now - self.began), file=sys.stderr, flush=True)

    def line(self, info: Info, seconds: float) -> str:
        """For example ``safe_distance  level 7  gamma 0.42  p≈3.1e-05  survivors 34/100  ...``."""
        goal = f"/{info.goal}" if info.goal else ""
        words = [self.label, *self._standing(info), f"sims {info.rollouts}{goal}"]
        return "  ".join([*words, *self._pace(info, seconds), *_troubles(info)])

    def _hush(self, silent: bool) -> None:
        if self.stop is not None:
            self.stop.silent = silent

    def _standing(self, info: Info) -> list[str]:
        """Where the estimate stands."""
        words = []
        if info.stage:
            words.append(f"level {info.stage}")
        if info.level is not None:
            words.append(f"gamma {self.problem.gamma(info.level):.3g}")
        if info.probability:  # 0 only says that it has not come so far
            words.append(f"p≈{info.probability:.2g}")
        elif info.probability is None and self.confidence is not None and info.rollouts:
            words.append(self._counted(info, self.confidence))
        if info.survivors is not None:
            words.append(f"survivors {info.survivors}/{info.particles}")
        return words

    def _counted(self, info: Info, confidence: float) -> str:
        """Failures over simulations; the interval only where they do not end by what is seen."""
        any_of = " any" if len(self.problem.names) > 1 else ""
        found = f"p{any_of} {info.failures / info.rollouts:.2g}"
        if info.goal is None:
            return found
        low, high = clopper_pearson(info.failures, info.rollouts, confidence, undecided=info.errors)
        return f"{found} ({low:.2g} .. {high:.2g})"

    def _pace(self, info: Info, seconds: float) -> list[str]:
        """Simulations a second, and the time that is left where it is known."""
        if seconds <= 0.0 or not info.rollouts:
            return []
        rate = info.rollouts / seconds
        words = [f"{rate:.1f}/s"]
        if info.goal and info.goal > info.rollouts:
            words.append(f"{duration((info.goal - info.rollouts) / rate)} left")
        return words

    def _view(self) -> Group:
        """The live lines: what it is, how far it is, what it found."""
        info, seconds = self.info, time.monotonic() - self.began
        standing = "   ".join([*self._standing(info), *_troubles(info)])
        pace = "   ".join([duration(seconds), *self._pace(info, seconds)])
        far = Table.grid(padding=(0, 2, 0, 0))
        of = f" of {info.goal:,}" if info.goal else ""
        done = Text(f"{info.rollouts:,}{of} simulations" if info.rollouts else "starting", no_wrap=True)
        bar = [ProgressBar(info.goal, min(info.rollouts, info.goal), width=24)] if info.goal else []
        far.add_row(*bar, done, Text(pace, style="dim", no_wrap=True))
        head = Text(self.label, style="bold", no_wrap=True, overflow="ellipsis")
        rows: list[RenderableType] = [head, far, Text(standing)]
        if self.stop is not None and self.stop():
            words = "stopping after the chunk in hand; Ctrl-C once more leaves at once"
            rows.append(Text(words, style="yellow"))
        return Group(*rows)


def duration(seconds: float) -> str:
    """``0:07``, ``12:34``, ``3:25:45``."""
    if not math.isfinite(seconds) or seconds > _LONG:
        return "days"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _troubles(info: Info) -> list[str]:
    words = [f"failures {info.failures}", f"errors {info.errors}"]
    return words + [
        f"{name.replace('_', ' ')} {many}" for name, many in info.counts.items() if many and name != "solves"
    ]


def _redraws() -> bool:
    """Whether stderr is a terminal that can move its cursor, whatever the environment says of colours."""
    return sys.stderr.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", "")
