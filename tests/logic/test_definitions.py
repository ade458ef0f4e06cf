"""Random formulas, quantifiers over relations included, against a literal evaluator of the definitions."""

import functools
import math
import operator
import random

import numpy as np
import pytest

from avrare.base import batch
from avrare.logic import Formula, FormulaMonitor, stl
from avrare.logic.syntax import nodes as f
from avrare.logic.syntax.printer import to_text

INF = math.inf
VEHICLES = 2
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

    def __init__(self, samples, row, seen, length, closed, truth=False):
        self.samples, self.row, self.seen, self.length = samples, row, seen, length
        self.closed, self.truth = closed, truth
        self.top, self.bottom = (True, False) if truth else (INF, -INF)
        self.at = functools.cache(self._at)

    def _term(self, term, i, env):
        match term:
            case f.Number(value):
                return value
            case f.Signal(name):
                return float(self.samples[name][(self.row, i, *(env[axis] for axis in term.axes))])
            case f.Arithmetic("-", left, right):
                return self._term(left, i, env) - self._term(right, i, env)

    def _compare(self, op, left, right, i, env):
        if i >= self.seen:
            return {"==": (-INF, 0.0), "!=": (0.0, INF)}.get(op, (-INF, INF))
        x, y = self._term(left, i, env), self._term(right, i, env)
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

    def _or(self, node, i, default, env):
        return self.at(node, i, env) if self._exists(i) else (default, default)

    def _at_least(self, count, values):
        """Return the count-th largest of the lower and of the upper values."""
        if count > len(values):
            return self.bottom, self.bottom
        return tuple(sorted(ends, reverse=True)[count - 1] for ends in zip(*values, strict=True))

    def _at(self, node, i, env=()):
        match node:
            case f.Constant(value):
                return (self.top if value else self.bottom,) * 2
            case f.Predicate(term):
                return self._compare(">", term, f.Number(0.0), i, env)
            case f.Comparison(op, left, right):
                return self._compare(op, left, right, i, env)
            case f.Not(child):
                return self._not(self.at(child, i, env))
            case f.Connective(op, left, right):
                v, w = self.at(left, i, env), self.at(right, i, env)
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
                return join(self.at(child, k, env) for k in where)
            case f.Step(op, child):
                return self._step(op, child, i, env)
            case f.Until():
                return self._until(node, i, env)
            case f.Quantifier():
                values = [self.at(node.child, i, (*env, v)) for v in range(VEHICLES)]
                counts = {"forall": VEHICLES, "exists": 1, "at_least": node.count}
                return self._at_least(counts[node.op], values)

    def _step(self, op, child, i, env):
        after, before = (functools.partial(self._or, child, k, env=env) for k in (i + 1, i - 1))
        match op:
            case "next":
                return after(self.top)
            case "s_next":
                return after(self.bottom)
            case "prev":
                return before(self.top)
            case "s_prev":
                return before(self.bottom)
            case "rise":
                return self._least([self._not(before(self.bottom)), self.at(child, i, env)])
            case "fall":
                return self._least([before(self.top), self._not(self.at(child, i, env))])

    def _until(self, node, i, env):
        left, right, end = node.left, node.right, 1 if self.closed else 0
        if node.op == "since":
            held = [(k, range(k + 1 - end, i + 1)) for k in self._past(i, node.lo, node.hi)]
        else:
            held = [(k, range(i, k + end)) for k in self._future(i, node.lo, node.hi)]
        witnesses = [
            self._least([self.at(right, k, env), *(self.at(left, j, env) for j in span)]) for k, span in held
        ]
        if node.op == "unless":
            witnesses.append(self._least(self.at(left, k, env) for k in self._future(i, 0, node.hi)))
        return self._most(witnesses)


def random_formula(rng, size, past_only=False, bound=0):
    """Return a random tree; ``bound``: how many quantifiers are around it."""
    if size <= 1:
        return random_atom(rng, bound)
    kinds = ["not", "connective", "connective", "past", "since", "past step"]
    kinds += [] if past_only else ["future", "future", "until", "future step"]
    kind = rng.choice(kinds + ["quantifier"] * 2 * (bound < 2))
    lo = rng.choice([0, 0, 0, 1, 2])
    hi = rng.choice([lo, lo + 1, lo + 3, INF])
    small = functools.partial(random_formula, rng, past_only=past_only, bound=bound)
    if kind in ("connective", "since", "until"):
        part = rng.randint(1, size - 1)
        left, right = small(part), small(size - part)
        if kind == "connective":
            return f.Connective(rng.choice(["and", "or", "implies", "iff", "xor"]), left, right)
        return f.Until("since" if kind == "since" else rng.choice(["until", "unless"]), lo, hi, left, right)
    if kind == "quantifier":
        near = f.Comparison(">", f.Signal("near(others, ego)", (f"v{bound}", "ego"), (bound,)), f.Number(0.0))
        child = f.Connective(rng.choice(["and", "or"]), near, small(size - 1, bound=bound + 1))
        count = rng.randint(1, 3)
        op = "at_least" if count > 1 else rng.choice(["forall", "exists", "at_least"])
        return f.Quantifier(op, f"v{bound}", "others", child, bound, count)
    child = small(size - 1)
    if kind == "not":
        return f.Not(child)
    if kind in ("past", "future"):
        ops = ["once", "historically"] if kind == "past" else ["always", "eventually"]
        return f.Window(rng.choice(ops), lo, hi, child)
    ops = ["prev", "s_prev", "rise", "fall"] if kind == "past step" else ["next", "s_next"]
    return f.Step(rng.choice(ops), child)


def random_atom(rng, bound):
    kind = rng.random()
    if kind < 0.05 and not bound:
        return f.Constant(rng.random() < 0.5)
    if kind < 0.15:
        return f.Predicate(f.Signal("p"))
    left = f.Signal(rng.choice("pq")) if kind < 0.9 else f.Arithmetic("-", f.Signal("p"), f.Signal("q"))
    if bound and kind > 0.5:
        axes = (0,) if bound == 1 else rng.choice([(0,), (1,), (0, 1), (1, 0), (1, 1)])
        name = "near(others, ego)" if len(axes) == 1 else "ahead(others, others)"
        left = f.Signal(name, (*(f"v{axis}" for axis in axes), *["ego"] * (len(axes) == 1)), axes)
    return f.Comparison(rng.choice(list(COMPARE)), left, f.Number(float(rng.randint(-1, 1))))


def make(node, until="closed"):
    return Formula(to_text(node), 1.0, until, derived=node)


def random_signals(seed, rows, steps):
    """Return small whole numbers, so that ties and exact thresholds are frequent."""
    rng = np.random.default_rng(seed)
    shapes = {"p": (), "q": (), "near(others, ego)": (VEHICLES,), "ahead(others, others)": (VEHICLES,) * 2}
    return {name: rng.integers(-3, 4, (rows, steps, *shape)).astype(float) for name, shape in shapes.items()}


def follow(monitor, state, signals, steps):
    """Return the state after some samples, and the verdict of each."""
    verdicts = []
    for t in steps:
        state, verdict = monitor.update(state, {name: x[:, t].copy() for name, x in signals.items()})
        verdicts.append(verdict)
    return state, verdicts


def column(verdicts, name):
    return np.stack([getattr(verdict, name) for verdict in verdicts], axis=1)


def formulas(count, first_seed, past_only=False):
    for seed in range(first_seed, first_seed + count):
        rng = random.Random(seed)
        yield seed, random_formula(rng, rng.randint(1, 6), past_only)


@READINGS
@pytest.mark.parametrize("steps", [1, 2, 9])
def test_offline_and_truth_equal_the_definitions(until, steps):
    for seed, node in formulas(150, 1000 * steps):
        formula, signals = make(node, until), random_signals(seed, 2, steps)
        robustness, satisfied = formula.robustness(signals), formula.satisfied(signals)
        for row in range(2):
            margins = Literal(signals, row, steps, steps, until == "closed")
            truths = Literal(signals, row, steps, steps, until == "closed", truth=True)
            assert list(robustness[row]) == [margins.at(node, i)[0] for i in range(steps)], to_text(node)
            assert list(satisfied[row]) == [truths.at(node, i)[0] for i in range(steps)], to_text(node)


def check_prefixes(node, seed, until, steps=8):
    formula, signals = make(node, until), random_signals(seed, 2, steps)
    monitor, prefixes = FormulaMonitor(formula), formula.prefixes(signals)
    _, verdicts = follow(monitor, monitor.start(2), signals, range(steps))
    for row in range(2):
        for t in range(steps):
            closed = until == "closed"
            expected = Literal(signals, row, t + 1, t + 1, closed).at(node, 0)[0]
            truth = Literal(signals, row, t + 1, t + 1, closed, truth=True).at(node, 0)[0]
            assert prefixes[row, t] == expected, to_text(node)
            assert verdicts[t].robustness[row] == expected, to_text(node)
            assert verdicts[t].violated[row] == (not truth), to_text(node)
        assert np.array_equal(column(verdicts, "score")[row], np.maximum.accumulate(-prefixes[row]))


@READINGS
def test_prefixes_and_monitor_equal_the_definitions(until):
    for seed, node in formulas(40, 0):
        check_prefixes(node, seed, until)
    for seed, child in formulas(30, 500):
        check_prefixes(f.Window("always", 0, INF, child), seed, until)


@pytest.mark.slow
@READINGS
def test_many_prefixes_equal_the_definitions(until):
    for seed, node in formulas(200, 40):
        check_prefixes(node, seed, until)


@READINGS
def test_the_margin_is_that_of_the_newest_sample(until):
    for seed, child in formulas(100, 800, past_only=True):
        signals = random_signals(seed, 2, 8)
        monitor = FormulaMonitor(make(f.Window("always", 0, INF, child), until))
        state, inner = monitor.start(2), make(child, until).robustness(signals)
        for t in range(8):
            state, _ = follow(monitor, state, signals, [t])
            assert np.array_equal(monitor.margin(state), inner[:, t])


@READINGS
def test_intervals_equal_the_definitions(until):
    steps = 5
    for seed, node in formulas(120, 3000):
        formula, signals = make(node, until), random_signals(seed, 1, steps)
        for length in (None, steps, steps + 3):
            intervals = formula.intervals(signals, length=length)[0]
            expected = [
                Literal(signals, 0, t + 1, length, until == "closed").at(node, 0) for t in range(steps)
            ]
            assert list(map(tuple, intervals)) == expected, (to_text(node), length)
            if length == steps:
                assert intervals[-1, 0] == intervals[-1, 1] == formula.robustness(signals)[0, 0]


@READINGS
@pytest.mark.parametrize("length", [None, 7, 9, 12])
def test_interval_monitors_decide_what_follows_and_nothing_too_early(until, length):
    steps = length or 9
    for seed, node in formulas(40, 9000 + steps):
        formula, signals = make(node, until), random_signals(seed, 3, steps)
        monitor = formula.interval_monitor(length)
        _, verdicts = follow(monitor, monitor.start(3), signals, range(steps))
        ends = np.stack([column(verdicts, name) for name in ("lower", "upper")], axis=2)
        assert np.array_equal(ends, formula.intervals(signals, length))
        decided, violated = column(verdicts, "decided"), column(verdicts, "violated")
        assert not violated[~decided].any()
        if length or formula.horizon < steps:
            kept = np.broadcast_to(formula.satisfied(signals)[:, :1], decided.shape)
            assert decided[:, -1].all()
            assert np.array_equal(violated[decided], ~kept[decided])


@pytest.mark.parametrize("kind", [Formula.monitor, Formula.interval_monitor])
def test_copies_and_neighbours_change_nothing(kind):
    steps, index = 7, np.array([2, 0, 0])
    for seed, node in formulas(60, 6000):
        signals, cut = random_signals(seed, 4, steps), 1 + seed % (steps - 1)
        monitor = kind(make(node))
        state, _ = follow(monitor, monitor.start(4), signals, range(cut))
        before = [leaf.copy() for leaf in batch.leaves(state)]
        copied = batch.concatenate([batch.take(state, index[:1]), batch.take(state, index[1:])])
        later = {name: x[index] for name, x in signals.items()}
        _, after = follow(monitor, copied, later, range(cut, steps))
        _, straight = follow(monitor, state, signals, range(cut, steps))
        assert all(map(np.array_equal, before, batch.leaves(state)))
        for i, row in enumerate(index):
            own = {name: x[row : row + 1] for name, x in signals.items()}
            _, alone = follow(monitor, monitor.start(1), own, range(steps))
            for a, b, c in zip(after, straight, alone[cut:], strict=True):
                for name in vars(a):
                    assert getattr(a, name)[i] == getattr(b, name)[row] == getattr(c, name)[0], to_text(node)


def test_robustness_and_truth_have_the_same_sign():
    for seed, node in formulas(200, 5000):
        exempt = any(getattr(part, "op", "") in ("iff", "xor", "==", "!=") for part in f.walk(node))
        signals = random_signals(seed, 2, 8)
        robustness, satisfied = make(node).robustness(signals), make(node).satisfied(signals)
        if not exempt:
            assert satisfied[robustness > 0].all()
            assert not satisfied[robustness < 0].any()


def test_text_is_read_back():
    for _, node in formulas(300, 7000):
        assert stl(to_text(node), warn=False).node == node
        assert str(stl(to_text(node), dt=0.1, warn=False)) == to_text(node)


def random_term(rng, depth):
    if depth == 0:
        return rng.choice([f.Signal("G"), f.Signal("q.r"), f.Signal("min"), f.Number(rng.uniform(0.0, 9.0))])
    parts = [random_term(rng, rng.randrange(depth)) for _ in range(2)]
    kinds = [f.Arithmetic(rng.choice("+-*/"), *parts), f.Negative(parts[0]), f.Call("max", tuple(parts))]
    return rng.choice([*kinds, f.Call("sqrt", (parts[0],))])


def test_terms_are_read_back():
    for seed in range(300):
        rng = random.Random(seed)
        node = f.Comparison(rng.choice(list(COMPARE)), random_term(rng, 3), random_term(rng, 3))
        assert stl(to_text(node), warn=False).node == node
