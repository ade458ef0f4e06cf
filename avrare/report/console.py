"""What a person sees in the terminal: a live progress line and a table at the end."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from avrare.estimation.plan import Info
from avrare.estimation.result import Result
from avrare.rollout.problem import Problem

_PLAIN_INTERVAL = 15.0
"""Seconds between two progress lines where the terminal cannot redraw one."""


class Progress:
    """A live line on stderr; plain lines at intervals where stderr is no terminal.

    Args:
        label: What is being estimated.
        problem: For the meaning of its levels.
    """

    def __init__(self, label: str, problem: Problem) -> None:
        self.label = label
        self.problem = problem
        self.console = Console(stderr=True)
        self.began = self.printed = time.monotonic()
        self._live = Live(console=self.console, refresh_per_second=4, transient=True)

    def __enter__(self) -> Progress:
        if self.console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.console.is_terminal:
            self._live.stop()

    def __call__(self, info: Info) -> None:
        """Show the newest state."""
        now = time.monotonic()
        if self.console.is_terminal:
            self._live.update(Text(self.line(info, now - self.began)))
        elif now - self.printed >= _PLAIN_INTERVAL:
            self.printed = now
            print(self.line(info, now - self.began), file=sys.stderr, flush=True)

    def line(self, info: Info, seconds: float) -> str:
        """For example ``safe_distance  level 7  gamma 0.42  p≈3.1e-05  survivors 34/100  ...``."""
        words = [self.label]
        if info.stage:
            words.append(f"level {info.stage}")
        if info.level is not None:
            words.append(f"gamma {self.problem.gamma(info.level):.3g}")
        if info.probability is not None:
            words.append(f"p≈{info.probability:.2g}")
        if info.survivors is not None:
            words.append(f"survivors {info.survivors}/{info.particles}")
        words.append(f"sims {info.rollouts}" + (f"/{info.goal}" if info.goal else ""))
        if seconds > 0.0:
            words.append(f"{info.rollouts / seconds:.1f}/s")
        words += [f"failures {info.failures}", f"errors {info.errors}"]
        words += [f"{name.replace('_', ' ')} {info.counts[name]}" for name in info.counts if name != "solves"]
        return "  ".join(words)


def table(title: str, results: Sequence[Result]) -> Table:
    """One row per specification."""
    view = Table(
        title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        pad_edge=False, show_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    view.add_column("specification", no_wrap=True)
    verdicts = any(result.verdict for result in results)
    errors = any(result.errors for result in results)
    for name in (
        "probability",
        "interval",
        "rollouts",
        "failures",
        *(["errors"] if errors else []),
        "seconds",
    ):
        view.add_column(name, justify="right", no_wrap=True)
    if verdicts:
        view.add_column("verdict", no_wrap=True)
    for result in results:
        low, high = result.interval
        row = [
            result.specification, number(result.probability), f"{number(low, 2)} .. {number(high, 2)}",
            str(result.rollouts), str(result.failures.count), *([str(result.errors)] if errors else []),
            f"{result.seconds:.1f}",
        ]  # fmt: skip
        if verdicts:
            row.append(_coloured(result.verdict))
        view.add_row(*row)
    return view


def notes(results: Sequence[Result]) -> list[str]:
    """Warnings of all results, and the counters where they are not zero; a shared one stands once."""
    lines: dict[str, list[str]] = {}
    for result in results:
        for name, message in result.health.items():
            lines.setdefault(f"warning {name}: {message}", []).append(result.specification)
        troubles = {name: n for name, n in result.counts.items() if n and name != "solves"}
        if troubles:
            text = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in troubles.items())
            lines.setdefault(f"{text} of {result.counts.get('solves', 0)} solves", []).append(
                result.specification
            )
    everywhere = len(results)
    return [
        text if len(names) == everywhere else f"{', '.join(names)}: {text}" for text, names in lines.items()
    ]


def number(value: float, digits: int = 3) -> str:
    """A probability in a few digits: 0, 0.0123, 3.4e-05."""
    if value == 0.0 or value == 1.0:
        return f"{value:.0f}"
    return f"{value:.{digits}g}" if value >= 1e-3 else f"{value:.1e}"


def _coloured(verdict: str | None) -> str:
    colours = {"pass": "green", "fail": "red", "inconclusive": "yellow"}
    return f"[{colours[verdict]}]{verdict}[/]" if verdict else "-"
