"""Costs of estimates for a relative error of 20 %: a table, and a figure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avrare.protocols import Floats
from benchmarks.studies.level_table import LEAST, Outcome

GOAL = 0.2
_HEADS = (
    "stack", "p", "estimator", "results", "chosen", "mean / p", "cover", "warned", "CW", "cost, stated",
    "cost, by scatter", "over the better of `mc` and `ams`",
)  # fmt: skip
_KINDS = {"stated": (-0.1, "o"), "by scatter": (0.1, "s")}
"""Costs: where they are drawn, and with which mark."""
_COLOURS = {"auto": "tab:blue", "ams": "tab:orange"}


@dataclass(frozen=True)
class Costs:
    """Results of an estimator on a stack.

    Attributes:
        found: The results.
    """

    found: list[Outcome]

    @property
    def truth(self) -> float:
        """Known probability."""
        return self.found[0].truth

    @property
    def monte_carlo(self) -> float:
        """Rollouts of Monte Carlo."""
        return (1.0 - self.truth) / self.truth / GOAL**2

    @property
    def stated(self) -> Floats:
        """Rollouts by the relative errors that the results state, each."""
        return np.array([(one.relative_error / GOAL) ** 2 * one.rollouts for one in self.found])

    @property
    def scattered(self) -> Floats:
        """Rollouts by the squared error of each result; their mean is what the scatter says."""
        cost = np.mean([one.rollouts for one in self.found])
        return np.array([(one.probability / self.truth - 1.0) ** 2 for one in self.found]) * cost / GOAL**2

    @property
    def cost(self) -> dict[str, Floats]:
        """Costs of the results, as stated and, if there are enough of them, by scatter.

        None where a result is 0: that has no relative error, and the scatter of zeros would be none.
        """
        if not all(one.probability > 0.0 for one in self.found):
            return {}
        return {"stated": self.stated} | ({"by scatter": self.scattered} if len(self.found) >= LEAST else {})

    @property
    def best(self) -> float:
        """Cost to compare with: by scatter, if there are enough results, else as stated."""
        costs = list(self.cost.values())
        return float(costs[-1].mean()) if costs else math.inf


def table(found: Mapping[str, Mapping[str, Costs]]) -> list[str]:
    """Return a table with a row for each stack and estimator, that of Monte Carlo computed."""
    lines = [f"| {' | '.join(_HEADS)} |", f"|{'---|' * len(_HEADS)}"]
    for stack, costs in found.items():
        lines += [f"| {' | '.join(entries)} |" for entries in _rows(stack, costs)]
    return lines


def _rows(stack: str, costs: Mapping[str, Costs]) -> Iterator[list[str]]:
    monte_carlo = next(iter(costs.values())).monte_carlo
    better = min([monte_carlo, *(one.best for name, one in costs.items() if name == "ams")])
    truth = f"{next(iter(costs.values())).truth:.2g}"
    yield [stack, truth, "`mc`", "exact", *[""] * 5, f"{monte_carlo:,.0f}", "", ""]
    for name, one in costs.items():
        values = np.array([each.probability for each in one.found]) / one.truth
        size, chosen = len(values), Counter(each.chosen for each in one.found)
        spread = f" ± {values.std(ddof=1) / math.sqrt(size):.3f}" if size > 1 else ""
        means = {kind: float(values.mean()) for kind, values in one.cost.items()}
        costs_told = [f"{means[kind]:,.0f}" if kind in means else "" for kind in _KINDS]
        ratio = f"{one.best / better:.2f}" if means else "no estimate"
        yield [
            stack, truth, f"`{name}`", str(size),
            ", ".join(f"`{each}` {count}" for each, count in sorted(chosen.items())),
            f"{values.mean():.3f}{spread}", str(sum(each.covers for each in one.found)),
            str(sum(bool(each.health) for each in one.found)), str(sum(each.misleads for each in one.found)),
            *costs_told, ratio,
        ]  # fmt: skip


def draw(found: Mapping[str, Mapping[str, Costs]], file: Path) -> None:
    """Draw the costs, with 95 % intervals of the means by bootstrap."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8.0, 0.6 + 0.75 * len(found)), layout="constrained")
    rng = np.random.default_rng(0)
    for place, costs in enumerate(found.values()):
        monte_carlo = next(iter(costs.values())).monte_carlo
        axes.plot([monte_carlo] * 2, [place - 0.3, place + 0.3], color="black", label="mc")
        for name, one in costs.items():
            for kind, values in one.cost.items():
                offset, marker = _KINDS[kind]
                low, high = _interval(values, rng)
                label = f"{name}, {kind}"
                y = place + offset + (0.05 if name == "ams" else -0.05)
                axes.plot([low, high], [y, y], color=_COLOURS[name], linewidth=1.0)
                axes.plot(values.mean(), y, marker, color=_COLOURS[name], label=label, markersize=5.0)
    names = [f"{stack}\np = {next(iter(costs.values())).truth:.2g}" for stack, costs in found.items()]
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("rollouts for a relative error of 20 %")
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    axes.legend(handles.values(), handles.keys(), fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110, metadata={"Software": None})
    plt.close(figure)


def _interval(values: Floats, rng: np.random.Generator) -> tuple[float, float]:
    if len(values) < 2:
        return float(values[0]), float(values[0])
    means = rng.choice(values, (2000, len(values))).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)
