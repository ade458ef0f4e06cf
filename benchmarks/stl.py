"""Speed of formula evaluation, beside rtamt and sentil in the same run: 1,000 trajectories of 41 samples.

    OMP_NUM_THREADS=1 python benchmarks/stl.py

Every engine starts from the same NumPy arrays. sentil needs a trace object of its own for each trajectory
(and prefix); building it is counted, and its evaluation alone is printed too. Offline: the robustness at
every sample. Every prefix: the robustness at sample 0 after each of the 41 samples, what splitting needs:
avrare's monitor step by step; the peers evaluate each prefix anew. Figures are CPU milliseconds, the least of
a few repetitions; rtamt is timed on the first 20 trajectories and scaled up. All engines must agree to 1e-9.
The peers come with the extra `test`; any that is missing is left out.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import avrare
from avrare.driving import Road, Scene
from avrare.logic import FormulaMonitor
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rule import build

ROWS, STEPS, SAMPLE = 1000, 41, 20
WORKLOADS = {
    "A": "always[0,40]((p>0) -> not (once[0,3](q>0)))",
    "B": "always[0,40](eventually[0,5](p>0))",
    "C": "(p>0) until[0,30] (q>0)",
}
GOALS = {"offline": {"A": 15, "B": 15, "C": 4}, "every prefix": dict.fromkeys("ABC", 300)}
Signals = dict[str, np.ndarray]


def cpu_ms(work: Callable[[], Any], repeat: int) -> tuple[float, Any]:
    """Return least CPU time of ``repeat`` calls, and what the last returned."""
    best, value = float("inf"), None
    for _ in range(repeat):
        began = time.process_time()
        value = work()
        best = min(best, time.process_time() - began)
    return best * 1e3, value


def traces() -> Signals:
    """Return slow random walks: both operands change sign now and then."""
    rng = np.random.default_rng(0)
    return {name: np.cumsum(rng.normal(scale=0.3, size=(ROWS, STEPS)), axis=1) + 0.5 for name in "pq"}


def avrare_offline(text: str, signals: Signals) -> tuple[float, np.ndarray]:
    formula = avrare.stl(text, until="half-open", warn=False)
    ms, values = cpu_ms(lambda: formula.robustness(signals), 50)
    return ms, values[:, 0]


def avrare_online(text: str, signals: Signals) -> tuple[float, np.ndarray]:
    monitor = FormulaMonitor(avrare.stl(text, until="half-open", warn=False))
    samples = [{name: x[:, t].copy() for name, x in signals.items()} for t in range(STEPS)]

    def follow() -> np.ndarray:
        state, values = monitor.start(ROWS), []
        for sample in samples:
            state, verdict = monitor.update(state, sample)
            values.append(verdict.robustness)
        return np.stack(values, axis=1)

    return cpu_ms(follow, 50)


class Sentil:
    """sentil with the formula parsed once; a trace of its own type is built from each array."""

    def __init__(self, text: str, signals: Signals) -> None:
        import sentil

        self.formula = sentil.Formula.parse(text)
        self.make = sentil.Trace
        self.signals = signals

    def trace(self, row: int, steps: int) -> Any:
        """Return the first ``steps`` samples of a trajectory."""
        times = np.arange(float(steps))
        return self.make(times, {name: x[row, :steps] for name, x in self.signals.items()})


def sentil_offline(text: str, signals: Signals) -> tuple[float, np.ndarray]:
    peer, rows = Sentil(text, signals), range(ROWS)
    signal = peer.formula.robustness_signal
    ms, values = cpu_ms(lambda: [signal(peer.trace(row, STEPS)) for row in rows], 10)
    return ms, np.array([each[0] for each in values])


def sentil_prefixes(text: str, signals: Signals) -> tuple[float, np.ndarray]:
    peer, rows, ends = Sentil(text, signals), range(ROWS), range(1, STEPS + 1)
    value = peer.formula.robustness
    ms, values = cpu_ms(lambda: [[value(peer.trace(row, end)) for end in ends] for row in rows], 2)
    return ms, np.array(values)


def sentil_alone(mode: str, text: str, signals: Signals) -> float:
    """Return CPU ms of evaluation alone, with every trace built beforehand."""
    peer = Sentil(text, signals)
    ends = [STEPS] if mode == "offline" else range(1, STEPS + 1)
    evaluate = peer.formula.robustness_signal if mode == "offline" else peer.formula.robustness
    built = [peer.trace(row, end) for row in range(ROWS) for end in ends]
    return cpu_ms(lambda: [evaluate(trace) for trace in built], 3)[0]


class Rtamt:
    """rtamt with the formula parsed once."""

    def __init__(self, text: str, signals: Signals) -> None:
        import rtamt

        self.spec = rtamt.StlDiscreteTimeOfflineSpecification()
        for name in signals:
            self.spec.declare_var(name, "float")
        self.spec.spec = text
        self.spec.parse()
        self.signals = signals

    def at_start(self, row: int, steps: int) -> float:
        """Return robustness at sample 0 of the first ``steps`` samples."""
        data = {name: x[row, :steps].tolist() for name, x in self.signals.items()}
        return float(self.spec.evaluate({"time": list(range(steps))} | data)[0][1])


def rtamt_offline(text: str, signals: Signals) -> tuple[float, np.ndarray]:
    peer = Rtamt(text, signals)
    ms, values = cpu_ms(lambda: [peer.at_start(row, STEPS) for row in range(SAMPLE)], 2)
    return ms * ROWS / SAMPLE, np.array(values)


def rtamt_prefixes(text: str, signals: Signals) -> tuple[float, np.ndarray]:
    peer = Rtamt(text, signals)
    steps = range(2, STEPS + 1)  # it cannot evaluate a single sample
    ms, values = cpu_ms(lambda: [[peer.at_start(row, t) for t in steps] for row in range(SAMPLE)], 1)
    first = np.full((SAMPLE, 1), np.nan)
    return ms * ROWS / SAMPLE * STEPS / len(steps), np.concatenate([first, np.array(values)], axis=1)


ENGINES = {
    "offline": {"avrare": avrare_offline, "sentil": sentil_offline, "rtamt": rtamt_offline},
    "every prefix": {"avrare": avrare_online, "sentil": sentil_prefixes, "rtamt": rtamt_prefixes},
}


def require_agreement(ours: np.ndarray, theirs: np.ndarray) -> None:
    known = ~np.isnan(theirs)
    np.testing.assert_allclose(ours[: len(theirs)][known], theirs[known], rtol=0, atol=1e-9)


def compare(console: Console, mode: str, signals: Signals) -> None:
    peers = [name for name in ("sentil", "rtamt") if importlib.util.find_spec(name)]
    table = Table(title=f"{mode}: CPU ms for {ROWS:,} trajectories of {STEPS} samples")
    for heading in (
        "workload",
        "avrare",
        *peers,
        *(f"{name} / avrare" for name in peers),
        "sentil alone",
        "goal",
    ):
        table.add_column(heading, justify="left" if heading == "workload" else "right")
    for key, text in WORKLOADS.items():
        ms, ours = ENGINES[mode]["avrare"](text, signals)
        cost, alone = {}, ""
        if "sentil" in peers:
            alone = f"{sentil_alone(mode, text, signals):,.1f}"
        for name in peers:
            cost[name], theirs = ENGINES[mode][name](text, signals)
            require_agreement(ours, theirs)
        ratios = [f"{cost[name] / ms:,.0f} x" for name in peers]
        table.add_row(
            f"{key}  {text}", f"{ms:.2f}", *(f"{cost[name]:,.1f}" for name in peers), *ratios,
            alone, f">= {GOALS[mode][key]} x",
        )  # fmt: skip
    console.print(table)


def rule_step(console: Console) -> None:
    """Time one step of R_G1 with its predicates for 1,000 particles and three vehicles."""
    rng = np.random.default_rng(1)
    road = Road((-1.75, 1.75, 5.25), 3.5, (0,))
    size = np.array([4.5, 4.5, 4.5]), np.array([1.8, 1.8, 1.8])
    scene = Scene(0.1, road, 4.5, 1.8, ("a", "b", "c"), *size, np.ones(3, dtype=bool))
    rule = build(TrafficRuleConfig(rule="R_G1"), scene)
    fields = {"x": 20.0, "y": 2.0, "heading": 0.05, "speed": 5.0, "acceleration": 1.0}

    def sample() -> Signals:
        ego = {f"ego_{name}": scale * rng.normal(size=ROWS) for name, scale in fields.items()}
        others = {f"others_{name}": scale * rng.normal(size=(ROWS, 3)) for name, scale in fields.items()}
        return ego | others | {"distance": np.abs(rng.normal(size=(ROWS, 3)))}

    samples = [sample() for _ in range(STEPS)]

    def follow() -> None:
        state = rule.start(ROWS)
        for signals in samples:
            state, _ = rule.update(state, signals)

    ms, _ = cpu_ms(follow, 10)
    console.print(f"R_G1 with its predicates, {ROWS:,} particles, 3 vehicles: {ms / STEPS:.3f} ms a step")


def main() -> None:
    console = Console(width=130)
    signals = traces()
    for mode in ENGINES:
        compare(console, mode, signals)
    rule_step(console)


if __name__ == "__main__":
    main()
