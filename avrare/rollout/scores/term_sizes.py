"""Sizes of a formula's terms, so that a score measures each of them in parts of its own size.

Minimum and maximum compare margins as numbers: in ``x < 4.6 and y < 400`` the second term hides behind the
first for as long as its margin is the larger number, whatever its unit. Divided by its size, every term is at
1 in the noise-free rollout and at 0 where it changes its truth.

A part of a formula whose robustness shows nothing before it fails is flat: no score leads there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from avrare.logic.formula import Formula, FormulaMonitor
from avrare.logic.monitor.monitors import MonitorState
from avrare.logic.semantics.input_signals import read_trace
from avrare.logic.semantics.normal_form import normalise
from avrare.logic.semantics.trace_evaluator import Evaluator
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.syntax import nodes
from avrare.logic.syntax.printer import to_text
from avrare.protocols import Floats, Signals, Specification, System, Verdict
from avrare.rollout.engine import simulate
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request

Sizes = tuple[Floats, ...]
"""Size of every term (steps + 1, V...), V as in the term's own values."""
Select = Callable[[Signals], Signals]
"""Function from a system's signals at one sample to those that a formula reads."""
PROBE_ROWS, _PROBE_SEED = 64, 0x517E5


def find_terms(node: nodes.Node) -> list[nodes.Node]:
    """Return the distinct comparisons of a formula that read signals."""
    terms = [part for part in nodes.walk(node) if isinstance(part, nodes.Comparison | nodes.Predicate)]
    return list(dict.fromkeys(part for part in terms if nodes.signals(part)))


def measure_terms(system: System, steps: int, formula: Formula, select: Select | None = None) -> Sizes | None:
    """Measure the terms' sizes by one noise-free rollout; None where the unscaled formula orders alike.

    The size of a term, for each vehicle, is its margin at the sample if that has one sign along the rollout,
    else the mean magnitude of its margin. Where that is 0 or unknown, it is half the range of the margin
    among 64 rollouts, at the sample where that is largest. These rollouts count in no estimate.
    """
    terms = find_terms(formula.node)
    if len(terms) == 1 and not any(isinstance(part, nodes.Quantifier) for part in nodes.walk(formula.node)):
        return None
    tape = np.zeros((1, steps + 1, system.noise_size))
    nominal = record(system, steps, formula.signals, Request.replay(tape), select)
    sizes = [_own_size(margin[:, 0]) for margin in _margins(formula, terms, nominal)] if nominal else []
    if not nominal or any(np.isnan(size).any() for size in sizes):
        rows = np.arange(PROBE_ROWS)
        request = Request.from_start(np.zeros_like(rows), rows)
        probe = record(system, steps, formula.signals, request, select)
        if not probe:
            return None
        spreads = [_spread(margin) for margin in _margins(formula, terms, probe)]
        sizes = (
            [np.where(np.isnan(size), spread, size) for size, spread in zip(sizes, spreads, strict=True)]
            if sizes
            else spreads
        )
    all_sizes = np.concatenate([size.reshape(steps + 1, -1) for size in sizes], axis=1)
    return None if np.allclose(all_sizes, all_sizes[:, :1], rtol=1e-9, atol=0.0) else tuple(sizes)


def record(
    system: System, steps: int, names: tuple[str, ...], request: Request, select: Select | None = None
) -> dict[str, Floats] | None:
    """Return the signals (N, steps + 1, ...) of the rows that reach the last step; None where none does."""
    request = replace(request, keep_carries=True, every=max(steps, 1))
    noise = NoiseSource(_PROBE_SEED, system.noise_size)
    outcome = simulate(system, (_Recorder(names, select),), steps, noise, request, scored=False)
    return next((carry.monitors[0] for t, _, carry in outcome.carries if t == steps), None)


class _Recorder(Specification):
    """Specification that never fails and remembers the signals."""

    def __init__(self, names: tuple[str, ...], select: Select | None) -> None:
        self.signals, self.select = names, select

    def start(self, n: int) -> dict[str, Floats]:
        return {}

    def update(self, state: dict[str, Floats], signals: Signals) -> tuple[dict[str, Floats], Verdict]:
        selected = self.select(signals) if self.select else signals
        arrays = {name: np.asarray(selected[name]) for name in self.signals if name in selected}
        # A value that is unknown, as of a predicate where two vehicles meet, tells no size.
        newest = {name: np.where(np.isnan(x), np.inf, x)[:, None] for name, x in arrays.items()}
        recorded = {
            name: np.concatenate([state[name], x], axis=1) if state else x for name, x in newest.items()
        }
        n = len(next(iter(signals.values())))
        return recorded, Verdict(np.zeros(n), np.zeros(n, dtype=np.bool_), np.zeros(n))


def _margins(formula: Formula, terms: list[nodes.Node], signals: Mapping[str, Floats]) -> list[Floats]:
    # (steps + 1, N, V...) of each term.
    trace = read_trace(signals, formula.signals)
    values: dict[nodes.Node, Floats] = {}
    algebra = RobustnessAlgebra()
    Evaluator(trace.samples, trace.steps, trace.rows, algebra, formula.closed, values=values)(formula.node)
    return [values[term] for term in terms]


def _own_size(margin: Floats) -> Floats:
    # (T, V...) from (T, V...); NaN where there is none.
    steady = (margin > 0.0).all(axis=0) | (margin < 0.0).all(axis=0)
    finite, size = np.isfinite(margin), np.abs(margin)
    with np.errstate(invalid="ignore"):
        mean = np.where(finite, size, 0.0).sum(axis=0) / finite.sum(axis=0)
    size = np.where(steady & finite, size, mean)
    return np.where(size > 0.0, size, np.nan)


def _spread(margin: Floats) -> Floats:
    # (T, V...) from (T, N, V...); 1 where there is none.
    finite = np.isfinite(margin)
    high, low = (np.where(finite, margin, side * np.inf) for side in (-1.0, 1.0))
    spread = 0.5 * (high.max(axis=1) - low.min(axis=1)).max(axis=0)
    return np.broadcast_to(np.where(spread > 0.0, spread, 1.0), (len(margin), *spread.shape))


class ScaledMonitor(Specification):
    """Monitor of a formula whose terms are divided by their sizes: it ranks particles, not verdicts.

    Attributes:
        formula: The formula, over further signals that hold the sizes.
        sizes: Size of every term of the original one.
        select: Function that makes the formula's signals of the system's; None: they are the same.
    """

    def __init__(self, formula: Formula, sizes: Sizes, select: Select | None = None) -> None:
        self.select = select
        terms = find_terms(formula.node)
        names = {
            term: nodes.Signal(f"size {k}", axes=tuple(range(size.ndim - 1)))
            for k, (term, size) in enumerate(zip(terms, sizes, strict=True))
        }
        self.sizes = dict(zip(terms, sizes, strict=True))
        self.formula: Formula = replace(formula, derived=_divide(formula.node, names))
        self._constants = {names[term].name: size for term, size in self.sizes.items()}
        self._monitor = FormulaMonitor(self.formula)

    def start(self, n: int) -> MonitorState:
        """Return the state before sample 0."""
        return self._monitor.start(n)

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Return state and verdict after one more sample."""
        return self._monitor.update(state, self.sample_at(signals, state.t))

    def margin(self, state: MonitorState) -> Floats | None:
        """Return the (N,) robustness of φ at the newest sample for ``always φ``, None for other shapes."""
        return self._monitor.margin(state)

    def robustness(self, signals: Mapping[str, Floats]) -> Floats:
        """Return the formula's robustness (N, steps + 1) on complete rollouts."""
        n = len(next(iter(signals.values())))
        return self.formula.robustness({**signals, **self.repeat_sizes(n)})

    def repeat_sizes(self, n: int) -> dict[str, Floats]:
        """Return the further signals (N, steps + 1, V...) that the formula reads."""
        return {name: np.broadcast_to(x, (n, *x.shape)) for name, x in self._constants.items()}

    def sample_at(self, signals: Signals, t: int) -> Signals:
        """Return the formula's signals at sample ``t`` with the sizes among them."""
        signals = self.select(signals) if self.select else signals
        n = len(next(iter(signals.values())))
        sizes = {name: _repeat(x[t], n) for name, x in self._constants.items()}
        return {**signals, **sizes}


def _repeat(size: Floats, n: int) -> Floats:
    table = np.empty((n, *np.shape(size)))  # several times faster than a broadcast view
    table[:] = size
    return table


def _divide(node: nodes.Node, sizes: Mapping[nodes.Node, nodes.Signal]) -> nodes.Node:
    if node not in sizes:
        return nodes.rebuild(node, lambda part: _divide(part, sizes))
    if isinstance(node, nodes.Predicate):
        return replace(node, term=nodes.Arithmetic("/", node.term, sizes[node]))
    assert isinstance(node, nodes.Comparison)
    left, right = (nodes.Arithmetic("/", term, sizes[node]) for term in (node.left, node.right))
    return replace(node, left=left, right=right)


def find_flat_parts(
    system: System,
    steps: int,
    formula: Formula,
    select: Select | None = None,
    guide: ScaledMonitor | None = None,
    *,
    by_sample: bool = False,
    failures: Floats | None = None,
) -> tuple[str, ...]:
    """Return the parts of a formula, each of which must hold, that are flat in 64 rollouts.

    A part is flat if all the rollouts that keep it, at least half of them, keep it by the same robustness,
    and no known failure breaks it. The rollouts are those of ``measure_terms``, and no part of any estimate.

    Args:
        system: The system.
        steps: Last step of a rollout.
        formula: The formula.
        select: Function that makes the formula's signals of the system's.
        guide: The formula with its terms in parts of their sizes, where that is the score.
        by_sample: The score compares the robustness at each sample: a flat part has one at every sample.
        failures: Tapes (F, steps + 1, noise_size) of known failures.
    """
    rows = np.arange(PROBE_ROWS)
    signals = record(system, steps, formula.signals, Request.from_start(np.zeros_like(rows), rows), select)
    if not signals:
        return ()
    judge, signals = (
        (guide.formula, signals | guide.repeat_sizes(PROBE_ROWS)) if guide else (formula, signals)
    )
    parts = split_requirements(normalise(formula.node))
    judged = split_requirements(normalise(judge.node))
    flat = [
        part
        for part, scored in zip(parts, judged, strict=True)
        if nodes.signals(part) and is_flat(replace(judge, derived=scored), signals, by_sample)
    ]
    if flat and failures is not None and len(failures):
        replayed = record(system, steps, formula.signals, Request.replay(failures), select) or signals
        flat = [part for part in flat if replace(formula, derived=part).robustness(replayed).min() >= 0.0]
    return tuple(map(to_text, flat))


def split_requirements(node: nodes.Node) -> list[nodes.Node]:
    """Split a normalised formula into parts that must all hold."""
    match node:
        case nodes.Connective("and", left, right):
            return [*split_requirements(left), *split_requirements(right)]
        case nodes.Window("always" | "historically") | nodes.Quantifier(op="forall"):
            return [replace(node, child=part) for part in split_requirements(node.child)]
    return [node]


def is_flat(part: Formula, signals: dict[str, Floats], by_sample: bool) -> bool:
    """Return whether all rollouts that satisfy a part have the same robustness, which then ranks none."""
    whole = part.robustness(signals)
    passing = whole[:, 0] >= 0.0
    if by_sample and isinstance(part.node, nodes.Window) and part.node.op == "always":
        whole = replace(part, derived=part.node.child).robustness(signals)
    robustness = whole[passing] if by_sample else whole[passing, :1]
    return len(robustness) >= PROBE_ROWS // 2 and bool((robustness == robustness[0]).all())
