"""Random formulas against a literal evaluator of the definitions: slow, and independent of the product."""

import functools
import math
import operator
import random

import numpy as np
import pytest

from avrare.logic import FormulaMonitor, stl
from avrare.logic.syntax import nodes as f
from avrare.logic.syntax.printer import to_text as str_of

INF = math.inf
UNKNOWN_TAIL = 16  # samples after the last one seen, longer than any past window below
READINGS = pytest.mark.parametrize("until", ["closed", "half-open"])
COMPARE = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq,
    "!=": operator.ne,
}  # fmt: skip


class Literal:
    """(lower, upper) of a formula at a sample; the two are equal where everything is known.

    length: samples of the trace, None when it goes on for ever; samples from ``seen`` on may be anything.
    """

    def __init__(self, samples, seen, length, closed, truth=False):
        self.samples, self.seen, self.length, self.closed, self.truth = samples, seen, length, closed, truth
        self.top, self.bottom = (True, False) if truth else (INF, -INF)
        self.at = functools.cache(self._at)

    def _term(self, term, i):
        match term:
            case f.Number(value):
                return value
            case f.Signal(name):
                return self.samples[name][i]
            case f.Arithmetic("-", left, right):
                return self._term(left, i) - self._term(right, i)

    def _compare(self, op, left, right, i):
        if i >= self.seen:
            return {"==": (-INF, 0.0), "!=": (0.0, INF)}.get(op, (-INF, INF))
        x, y = self._term(left, i), self._term(right, i)
        if self.truth:
            return (COMPARE[op](x, y),) * 2
        gap = 0.0 if x == y else x - y
        margin = {"<": -gap, "<=": -gap, ">": gap, ">=": gap, "==": -abs(gap), "!=": abs(gap)}[op]
        return margin, margin

    def _not(self, v):
        return (not v[1], not v[0]) if self.truth else (-v[1], -v[0])

    def _least(self, values):
        values = list(values)
        return min((v[0] for v in values), default=self.top), min((v[1] for v in values), default=self.top)

    def _most(self, values):
        return self._not(self._least(map(self._not, values)))

    def _xor(self, v, w):
        if self.truth:
            return (v[0] != w[0],) * 2
        corners = [0.0 if x == y else abs(x - y) for x in v for y in w]
        overlap = v[0] <= w[1] and w[0] <= v[1]
        return (0.0 if overlap else min(corners)), max(corners)

    def _future(self, i, lo, hi):
        last = max(i + lo, self.seen + UNKNOWN_TAIL) if hi == INF else i + hi
        return range(i + lo, int(last if self.length is None else min(last, self.length - 1)) + 1)

    def _past(self, i, lo, hi):
        return range(int(max(0, i - hi)), i - lo + 1)

    def _exists(self, i):
        return i >= 0 and (self.length is None or i < self.length)

    def _or(self, node, i, default):
        return self.at(node, i) if self._exists(i) else (default, default)

    def _at(self, node, i):
        match node:
            case f.Constant(value):
                return (self.top if value else self.bottom,) * 2
            case f.Predicate(term):
                return self._compare(">", term, f.Number(0.0), i)
            case f.Comparison(op, left, right):
                return self._compare(op, left, right, i)
            case f.Not(child):
                return self._not(self.at(child, i))
            case f.Connective(op, left, right):
                v, w = self.at(left, i), self.at(right, i)
                match op:
                    case "and":
                        return self._least([v, w])
                    case "or":
                        return self._most([v, w])
                    case "implies":
                        return self._most([self._not(v), w])
                    case "xor":
                        return self._xor(v, w)
                    case "iff":
                        return self._not(self._xor(v, w))
            case f.Window(op, lo, hi, child):
                where = (self._future if op in ("always", "eventually") else self._past)(i, lo, hi)
                join = self._least if op in ("always", "historically") else self._most
                return join(self.at(child, k) for k in where)
            case f.Step(op, child):
                return self._step(op, child, i)
            case f.Until():
                return self._until(node, i)

    def _step(self, op, child, i):
        match op:
            case "next":
                return self._or(child, i + 1, self.top)
            case "s_next":
                return self._or(child, i + 1, self.bottom)
            case "prev":
                return self._or(child, i - 1, self.top)
            case "s_prev":
                return self._or(child, i - 1, self.bottom)
            case "rise":
                return self._least([self._not(self._or(child, i - 1, self.bottom)), self.at(child, i)])
            case "fall":
                return self._least([self._or(child, i - 1, self.top), self._not(self.at(child, i))])

    def _until(self, node, i):
        left, right, end = node.left, node.right, 1 if self.closed else 0
        if node.op == "since":
            held = [(k, range(k + 1 - end, i + 1)) for k in self._past(i, node.lo, node.hi)]
        else:
            held = [(k, range(i, k + end)) for k in self._future(i, node.lo, node.hi)]
        witnesses = [self._least([self.at(right, k), *(self.at(left, j) for j in span)]) for k, span in held]
        if node.op == "unless":
            witnesses.append(self._least(self.at(left, k) for k in self._future(i, 0, node.hi)))
        return self._most(witnesses)


def random_formula(rng, size, past_only=False):
    if size <= 1:
        return random_atom(rng)
    kinds = ["not", "connective", "connective", "past", "since", "past step"]
    kinds += [] if past_only else ["future", "future", "until", "future step"]
    kind = rng.choice(kinds)
    lo = rng.choice([0, 0, 0, 1, 2])
    hi = rng.choice([lo, lo + 1, lo + 3, INF])
    small = functools.partial(random_formula, rng, past_only=past_only)
    if kind in ("connective", "since", "until"):
        part = rng.randint(1, size - 1)
        left, right = small(part), small(size - part)
        if kind == "connective":
            return f.Connective(rng.choice(["and", "or", "implies", "iff", "xor"]), left, right)
        return f.Until("since" if kind == "since" else rng.choice(["until", "unless"]), lo, hi, left, right)
    child = small(size - 1)
    if kind == "not":
        return f.Not(child)
    if kind in ("past", "future"):
        ops = ["once", "historically"] if kind == "past" else ["always", "eventually"]
        return f.Window(rng.choice(ops), lo, hi, child)
    ops = ["prev", "s_prev", "rise", "fall"] if kind == "past step" else ["next", "s_next"]
    return f.Step(rng.choice(ops), child)


def random_atom(rng):
    kind = rng.random()
    if kind < 0.05:
        return f.Constant(rng.random() < 0.5)
    if kind < 0.15:
        return f.Predicate(f.Signal("p"))
    left = f.Signal(rng.choice("pq")) if kind < 0.9 else f.Arithmetic("-", f.Signal("p"), f.Signal("q"))
    return f.Comparison(rng.choice(list(COMPARE)), left, f.Number(float(rng.randint(-1, 1))))


def random_signals(seed, rows, steps):
    """Return small whole numbers, so that ties and exact thresholds are frequent."""
    rng = np.random.default_rng(seed)
    return {name: rng.integers(-3, 4, (rows, steps)).astype(float) for name in "pq"}


def lists(signals, row):
    return {name: list(map(float, x[row])) for name, x in signals.items()}


def run_online(formula, signals):
    monitor = FormulaMonitor(formula)
    state, verdicts = monitor.start(len(signals["p"])), []
    for t in range(signals["p"].shape[1]):
        state, verdict = monitor.update(state, {name: x[:, t].copy() for name, x in signals.items()})
        verdicts.append((verdict, monitor.margin(state)))
    return verdicts


def formulas(count, first_seed, past_only=False):
    for seed in range(first_seed, first_seed + count):
        rng = random.Random(seed)
        yield seed, random_formula(rng, rng.randint(1, 6), past_only)


@READINGS
@pytest.mark.parametrize("steps", [1, 2, 9])
def test_offline_and_truth_equal_the_definitions(until, steps):
    for seed, node in formulas(150, 1000 * steps):
        formula, signals = stl(str_of(node), until=until), random_signals(seed, 2, steps)
        robustness, satisfied = formula.robustness(signals), formula.satisfied(signals)
        for row in range(2):
            margins = Literal(lists(signals, row), steps, steps, until == "closed")
            truths = Literal(lists(signals, row), steps, steps, until == "closed", truth=True)
            assert list(robustness[row]) == [margins.at(node, i)[0] for i in range(steps)], str_of(node)
            assert list(satisfied[row]) == [truths.at(node, i)[0] for i in range(steps)], str_of(node)


def check_prefixes(node, seed, until, steps=8):
    formula, signals = stl(str_of(node), until=until), random_signals(seed, 2, steps)
    prefixes, verdicts = formula.prefixes(signals), run_online(formula, signals)
    for row in range(2):
        samples = lists(signals, row)
        for t in range(steps):
            closed = until == "closed"
            expected = Literal(samples, t + 1, t + 1, closed).at(node, 0)[0]
            truth = Literal(samples, t + 1, t + 1, closed, truth=True).at(node, 0)[0]
            assert prefixes[row, t] == expected, str_of(node)
            assert verdicts[t][0].robustness[row] == expected, str_of(node)
            assert verdicts[t][0].violated[row] == (not truth), str_of(node)
        scores = np.array([verdict.score[row] for verdict, _ in verdicts])
        assert np.array_equal(scores, np.maximum.accumulate(-prefixes[row]))


@pytest.mark.slow
@READINGS
def test_prefixes_and_monitor_equal_the_definitions(until):
    for seed, node in formulas(200, 0):
        check_prefixes(node, seed, until)


@pytest.mark.slow
@READINGS
def test_prefixes_and_monitor_equal_the_definitions_below_always(until):
    for seed, child in formulas(150, 500):
        check_prefixes(f.Window("always", 0, INF, child), seed, until)


@READINGS
def test_the_margin_is_that_of_the_newest_sample(until):
    for seed, child in formulas(100, 800, past_only=True):
        formula = stl(f"always ({str_of(child)})", until=until)
        signals = random_signals(seed, 2, 8)
        verdicts = run_online(formula, signals)
        inner = stl(str_of(child), until=until).robustness(signals)
        assert np.array_equal(np.stack([margin for _, margin in verdicts], axis=1), inner)


@READINGS
def test_intervals_equal_the_definitions(until):
    steps = 5
    for seed, node in formulas(120, 3000):
        formula, signals = stl(str_of(node), until=until), random_signals(seed, 1, steps)
        for length in (None, steps, steps + 3):
            intervals = formula.intervals(signals, length=length)[0]
            expected = [
                Literal(lists(signals, 0), t + 1, length, until == "closed").at(node, 0) for t in range(steps)
            ]
            assert list(map(tuple, intervals)) == expected, (str_of(node), length)
            assert all(a <= b for a, b in zip(intervals[:-1, 0], intervals[1:, 0], strict=True))
            assert all(a >= b for a, b in zip(intervals[:-1, 1], intervals[1:, 1], strict=True))
            if length == steps:
                assert intervals[-1, 0] == intervals[-1, 1] == formula.robustness(signals)[0, 0]


def test_robustness_and_truth_have_the_same_sign():
    for seed, node in formulas(200, 5000):
        exempt = any(getattr(part, "op", "") in ("iff", "xor", "==", "!=") for part in f.walk(node))
        signals = random_signals(seed, 2, 8)
        robustness = stl(str_of(node)).robustness(signals)
        satisfied = stl(str_of(node)).satisfied(signals)
        if not exempt:
            assert satisfied[robustness > 0].all()
            assert not satisfied[robustness < 0].any()


def test_text_is_read_back():
    for _, node in formulas(300, 7000):
        assert stl(str_of(node)).node == node
        assert str(stl(str_of(node), dt=0.1)) == str_of(node)
