"""Speed of formula evaluation, beside rtamt in the same run: 1,000 trajectories of 41 samples.

    OMP_NUM_THREADS=1 python benchmarks/stl.py

Both start from the same NumPy arrays. Offline: the robustness of whole trajectories. Every prefix: the
robustness at sample 0 after each sample, what splitting needs: avrare's monitor step by step; rtamt evaluates
each prefix anew. Figures are CPU milliseconds, the least of a few repetitions; rtamt is timed on the first 20
trajectories and scaled up. Both must agree to 1e-9.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import rtamt

import avrare
from avrare.logic import FormulaMonitor
from avrare.protocols import Floats

ROWS, STEPS, SAMPLE = 1000, 41, 20
FORMULAS = {
    "A": "always[0,40]((p>0) -> not (once[0,3](q>0)))",
    "B": "always[0,40](eventually[0,5](p>0))",
    "C": "(p>0) until[0,30] (q>0)",
}
Signals = dict[str, Floats]


def time_calls(work: Callable[[], Floats], repeat: int) -> tuple[float, Floats]:
    """Return the least CPU time of some calls [ms], and the value of the last."""
    best = float("inf")
    for _ in range(repeat):
        began = time.process_time()
        value = work()
        best = min(best, time.process_time() - began)
    return 1e3 * best, value


def follow(monitor: FormulaMonitor, samples: list[Signals]) -> Floats:
    """Return the robustness (N, T) after each sample."""
    state, values = monitor.start(ROWS), []
    for sample in samples:
        state, verdict = monitor.update(state, sample)
        values.append(verdict.robustness)
    return np.stack(values, axis=1)


def evaluate_with_rtamt(text: str, signals: Signals, ends: range) -> Floats:
    """Return the robustness (SAMPLE, E) of the first samples of trajectories, up to each end."""
    specification = rtamt.StlDiscreteTimeOfflineSpecification()
    for name in signals:
        specification.declare_var(name, "float")
    specification.spec = text
    specification.parse()

    def evaluate(row: int, end: int) -> float:
        data = {name: x[row, :end].tolist() for name, x in signals.items()}
        return float(specification.evaluate({"time": list(range(end))} | data)[0][1])

    return np.array([[evaluate(row, end) for end in ends] for row in range(SAMPLE)])


def main() -> None:
    """Print a line for each formula and way."""
    rng = np.random.default_rng(0)
    signals = {name: np.cumsum(rng.normal(scale=0.3, size=(ROWS, STEPS)), axis=1) + 0.5 for name in "pq"}
    samples = [{name: x[:, t].copy() for name, x in signals.items()} for t in range(STEPS)]
    for key, text in FORMULAS.items():
        formula = avrare.stl(text, until="half-open", warn=False)
        monitor = FormulaMonitor(formula)
        for way, ends, work in (
            ("offline", range(STEPS, STEPS + 1), lambda: formula.robustness(signals)[:, :1]),  # noqa: B023
            ("every prefix", range(2, STEPS + 1), lambda: follow(monitor, samples)[:, 1:]),  # noqa: B023
        ):  # rtamt cannot evaluate a single sample
            ours, values = time_calls(work, 50)
            theirs, expected = time_calls(lambda: evaluate_with_rtamt(text, signals, ends), 1)  # noqa: B023
            np.testing.assert_allclose(values[:SAMPLE], expected, rtol=0, atol=1e-9)
            theirs *= ROWS / SAMPLE
            ratio = f"{theirs / ours:,.0f} times as long"
            print(f"{key}, {way}: avrare {ours:.2f} ms, rtamt {theirs:,.0f} ms, {ratio}")


if __name__ == "__main__":
    main()
