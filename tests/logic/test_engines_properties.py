"""Random formulas, quantifiers over relations included, against a literal evaluator of the definitions."""

import functools
import math
import operator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avrare.base import batch
from avrare.logic import Formula, FormulaMonitor, stl
from avrare.logic.syntax import nodes as f
from avrare.logic.syntax.printer import to_text

INF = math.inf
VEHICLES = 2
STEPS = 7
COMPARE = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq,
    "!=": operator.ne,
}  # fmt: skip


class Reference:
    """Margin and truth at a sample of one trace of ``steps`` samples, straight from the definitions."""

    def __init__(self, samples, row, steps, closed):
        self.samples, self.row, self.steps, self.closed = samples, row, steps, closed
        self.at = functools.cache(self._at)

    def _signal(self, signal, i, env):
        index = tuple(env[axis] for axis in signal.axes)
        return float(self.samples[signal.name][(self.row, i, *index)])

    def _atom(self, node, i, env):
        x, y = self._signal(node.left, i, env), node.right.value
        gap = {"<": y - x, "<=": y - x, ">": x - y, ">=": x - y, "==": -abs(x - y), "!=": abs(x - y)}
        return gap[node.op], COMPARE[node.op](x, y)

    @staticmethod
    def _least(values, top=(INF, True)):
        values = [*values, top]
        return min(v[0] for v in values), all(v[1] for v in values)

    @classmethod
    def _most(cls, values):
        return cls._not(cls._least(map(cls._not, values)))

    @staticmethod
    def _not(value):
        return -value[0], not value[1]

    def _at(self, node, i, env=()):
        match node:
            case f.Constant(value):
                return (INF if value else -INF), value
            case f.Comparison():
                return self._atom(node, i, env)
            case f.Not(child):
                return self._not(self.at(child, i, env))
            case f.Connective():
                return self._connective(node, i, env)
            case f.Quantifier():
                values = [self.at(node.child, i, (*env, v)) for v in range(VEHICLES)]
                if node.op != "at_least":
                    return (self._least if node.op == "forall" else self._most)(values)
                margins = sorted((margin for margin, _ in values), reverse=True)
                enough = node.count <= VEHICLES
                return margins[node.count - 1] if enough else -INF, sum(t for _, t in values) >= node.count
            case f.Window(op, lo, hi, child):
                join = self._least if op in ("always", "historically") else self._most
                return join(self.at(child, k, env) for k in self._span(i, lo, hi, op in f.PAST))
            case f.Step():
                return self._step(node, i, env)
            case f.Until():
                return self._until(node, i, env)

    def _connective(self, node, i, env):
        left, right = self.at(node.left, i, env), self.at(node.right, i, env)
        differ = (0.0 if left[0] == right[0] else abs(left[0] - right[0])), left[1] != right[1]
        match node.op:
            case "and":
                return self._least([left, right])
            case "or":
                return self._most([left, right])
            case "implies":
                return self._most([self._not(left), right])
            case _:
                return differ if node.op == "xor" else self._not(differ)

    def _span(self, i, lo, hi, past):
        return (
            range(int(max(0, i - hi)), i - lo + 1)
            if past
            else range(i + lo, int(min(i + hi, self.steps - 1)) + 1)
        )

    def _step(self, node, i, env):
        def near(k, outside):
            return self.at(node.child, k, env) if 0 <= k < self.steps else (INF if outside else -INF, outside)

        now = self.at(node.child, i, env)
        return {
            "next": lambda: near(i + 1, True),
            "s_next": lambda: near(i + 1, False),
            "prev": lambda: near(i - 1, True),
            "s_prev": lambda: near(i - 1, False),
            "rise": lambda: self._least([self._not(near(i - 1, False)), now]),
            "fall": lambda: self._least([near(i - 1, True), self._not(now)]),
        }[node.op]()

    def _until(self, node, i, env):
        past, own = node.op == "since", 1 if self.closed else 0
        witnesses = []
        for k in self._span(i, node.lo, node.hi, past):
            held = range(k + 1 - own, i + 1) if past else range(i, k + own)
            witnesses.append(
                self._least([self.at(node.right, k, env), *(self.at(node.left, j, env) for j in held)])
            )
        if node.op == "unless":
            span = self._span(i, 0, node.hi, past=False)
            witnesses.append(self._least(self.at(node.left, k, env) for k in span))
        return self._most(witnesses)


@st.composite
def atoms(draw, bound):
    op, threshold = draw(st.sampled_from(list(COMPARE))), f.Number(float(draw(st.integers(-1, 1))))
    names = ["p", "q"] if bound else ["p", "q", "constant"]
    name = draw(st.sampled_from(names + ["near", "ahead"][:bound] * 2))
    if name == "constant":
        return f.Constant(draw(st.booleans()))
    if name == "near":
        axis = draw(st.integers(0, bound - 1))
        return f.Comparison(op, f.Signal("near(others, ego)", (f"v{axis}", "ego"), (axis,)), threshold)
    if name == "ahead":
        axes = draw(st.sampled_from([(0, 1), (1, 0), (1, 1)]))
        return f.Comparison(
            op, f.Signal("ahead(others, others)", tuple(f"v{a}" for a in axes), axes), threshold
        )
    return f.Comparison(op, f.Signal(name), threshold)


KINDS = ["not", "connective", "connective", "window", "window", "until", "until", "step", "quantifier"]


@st.composite
def formulas(draw, depth=4, bound=0, exact_signs=False):
    if depth <= 1:
        return draw(atoms(bound))
    kind = draw(st.sampled_from([*KINDS, "atom"][: None if bound < 2 else -2]))
    small = functools.partial(formulas, depth - 1, bound, exact_signs)
    lo = draw(st.sampled_from([0, 0, 0, 1, 2]))
    hi = draw(st.sampled_from([lo, lo + 1, lo + 3, INF, INF]))
    match kind:
        case "atom":
            return draw(atoms(bound))
        case "not":
            return f.Not(draw(small()))
        case "connective":
            ops = ["and", "or", "implies"] + ["iff", "xor"] * (not exact_signs)
            return f.Connective(draw(st.sampled_from(ops)), draw(small()), draw(small()))
        case "window":
            op = draw(st.sampled_from(["always", "eventually", "historically", "once"]))
            return f.Window(op, lo, hi, draw(small()))
        case "until":
            return f.Until(
                draw(st.sampled_from(["until", "since", "unless"])), lo, hi, draw(small()), draw(small())
            )
        case "step":
            op = draw(st.sampled_from(["next", "s_next", "prev", "s_prev", "rise", "fall"]))
            return f.Step(op, draw(small()))
        case _:
            depends = f.Comparison(
                ">", f.Signal("near(others, ego)", (f"v{bound}", "ego"), (bound,)), f.Number(0.0)
            )
            child = f.Connective(
                draw(st.sampled_from(["and", "or"])),
                depends,
                draw(formulas(depth - 1, bound + 1, exact_signs)),
            )
            op = draw(st.sampled_from(["forall", "exists", "at_least"]))
            return f.Quantifier(op, f"v{bound}", "others", child, bound, draw(st.integers(1, 3)))


def make(node, until="closed"):
    return Formula(to_text(node), 1.0, until, derived=node)


def random_signals(seed, rows=3, steps=STEPS):
    """Return small whole numbers, so that ties and exact thresholds are frequent."""
    rng = np.random.default_rng(seed)
    shapes = {"p": (), "q": (), "near(others, ego)": (VEHICLES,), "ahead(others, others)": (VEHICLES,) * 2}
    return {name: rng.integers(-2, 3, (rows, steps, *shape)).astype(float) for name, shape in shapes.items()}


def at(signals, t):
    return {name: x[:, t].copy() for name, x in signals.items()}


def follow(monitor, state, signals, steps):
    verdicts = []
    for t in steps:
        state, verdict = monitor.update(state, at(signals, t))
        verdicts.append(verdict)
    return state, verdicts


def column(verdicts, name):
    return np.stack([getattr(verdict, name) for verdict in verdicts], axis=1)


def examples(count):
    return settings(max_examples=count, deadline=None, derandomize=True, database=None)


READINGS = st.sampled_from(["closed", "half-open"])
SEEDS = st.integers(0, 2**16)


@pytest.mark.slow
@examples(150)
@given(formulas(), READINGS, SEEDS)
def test_offline_equals_the_definitions(node, until, seed):
    formula, signals = make(node, until), random_signals(seed, rows=2)
    robustness, satisfied = formula.robustness(signals), formula.satisfied(signals)
    for row in range(2):
        reference = Reference(signals, row, STEPS, until == "closed")
        expected = [reference.at(node, i) for i in range(STEPS)]
        assert list(zip(robustness[row], satisfied[row], strict=True)) == expected


@pytest.mark.slow
@examples(250)
@given(formulas(), READINGS, SEEDS)
def test_online_equals_the_definitions_on_every_prefix(node, until, seed):
    formula, signals = make(node, until), random_signals(seed, rows=1)
    monitor = FormulaMonitor(formula)
    _, verdicts = follow(monitor, monitor.start(1), signals, range(STEPS))
    robustness, violated = column(verdicts, "robustness")[0], column(verdicts, "violated")[0]
    expected = [Reference(signals, 0, t + 1, until == "closed").at(node, 0) for t in range(STEPS)]
    assert list(zip(robustness, ~violated, strict=True)) == expected
    assert np.array_equal(formula.prefixes(signals)[0], robustness)


UNBOUNDED = [
    "always (p > 0 -> eventually q > 0)",
    "always eventually p",
    "(always p) until q",
    "eventually always p",
    "always (eventually (p and always q))",
    "always (p -> eventually[2:inf] q)",
    "always (p -> (q until p) or eventually[0,2] always[0,3] q)",
    "eventually[0,3] always (p -> once[0,2] eventually q)",
    "not ((always (p -> eventually q)) until[1,5] (historically (eventually q)))",
    "always (p -> not (q until eventually (p > 1)))",
    "always (p unless q)",
    "always[2,9] (p since eventually q)",
    "always (next (p until q) and prev eventually q)",
]


@pytest.mark.parametrize("until", ["closed", "half-open"])
@pytest.mark.parametrize("words", UNBOUNDED)
def test_nested_unbounded_operators_equal_the_definitions(words, until):
    formula, signals = stl(words, until=until, warn=False), random_signals(11, rows=20, steps=25)
    monitor, prefixes = FormulaMonitor(formula), formula.prefixes(signals)
    _, verdicts = follow(monitor, monitor.start(20), signals, range(25))
    for t in range(25):
        seen = {name: x[:, : t + 1] for name, x in signals.items()}
        assert np.array_equal(verdicts[t].robustness, formula.robustness(seen)[:, 0])
        assert np.array_equal(verdicts[t].violated, ~formula.satisfied(seen)[:, 0])
    assert np.array_equal(prefixes, column(verdicts, "robustness"))


WIDE = [
    "always (p -> (p > -2 until[0,60] q > 1))",
    "always eventually[0,60] p",
    "always[0,9] eventually[3,30] (p > 1)",
    "eventually always[0,2] (p and historically[1,13] q < 2)",
    "always (p -> eventually[0,40] (q > 1))",
    "always (once[2,37] p or (p since[1,30] q))",
    "always (always[0,15] once eventually[0,5] p)",
    "once eventually[0,50] p",
    "historically[1,3] (p > -3 until[0,50] q > 2)",
]


@pytest.mark.parametrize("until", ["closed", "half-open"])
@pytest.mark.parametrize("words", WIDE)
def test_wide_windows_equal_the_evaluation_of_every_prefix(words, until):
    """Cross the widths at which a monitor changes its ways; rows alone give the same bits."""
    formula, signals = stl(words, until=until, warn=False), random_signals(13, rows=3, steps=70)
    signals = {
        name: x + np.random.default_rng(14).normal(size=x.shape)
        for name, x in signals.items()
        if len(name) < 2
    }
    monitor = FormulaMonitor(formula)
    _, verdicts = follow(monitor, monitor.start(3), signals, range(70))
    for t, verdict in enumerate(verdicts):
        seen = {name: x[:, : t + 1] for name, x in signals.items()}
        assert np.array_equal(verdict.robustness, formula.robustness(seen)[:, 0])
        assert np.array_equal(verdict.violated, ~formula.satisfied(seen)[:, 0])
    _, alone = follow(monitor, monitor.start(1), {name: x[1:2] for name, x in signals.items()}, range(70))
    for name in ("robustness", "violated", "score"):
        assert np.array_equal(column(verdicts, name)[1], column(alone, name)[0])


@pytest.mark.parametrize("words", UNBOUNDED)
def test_a_step_does_not_grow_with_time(words):
    """Check that what is carried stops growing: a step has the same work at every sample."""
    signals = random_signals(12, rows=2, steps=80)
    for monitor in (FormulaMonitor(stl(words, warn=False)), stl(words, warn=False).interval_monitor()):
        state, _ = follow(monitor, monitor.start(2), signals, range(15))
        sizes = set()
        for t in range(15, 80):
            state, _ = monitor.update(state, at(signals, t))
            sizes.add(sum(leaf.nbytes for leaf in batch.leaves(state)))
        assert len(sizes) == 1
        assert sizes.pop() < 10_000


@pytest.mark.slow
@examples(200)
@given(formulas(), READINGS, SEEDS, st.sampled_from([STEPS + more for more in (0, 1, 2, 3, 5, 30)]))
def test_intervals_bracket_what_follows(node, until, seed, length):
    formula = make(node, until)
    whole = random_signals(seed, rows=4, steps=length)
    seen = {name: x[:, :STEPS] for name, x in whole.items()}
    for x, first in zip(whole.values(), seen.values(), strict=True):
        first[1:], x[1:, :STEPS] = first[0], x[0, :STEPS]  # four continuations of one beginning
    monitor = formula.interval_monitor(length)
    _, verdicts = follow(monitor, monitor.start(4), whole, range(length))
    lower, upper = column(verdicts, "lower"), column(verdicts, "upper")
    decided, violated = column(verdicts, "decided"), column(verdicts, "violated")
    final, satisfied = formula.robustness(whole)[:, :1], formula.satisfied(whole)[:, :1]
    assert (lower[:, 1:] >= lower[:, :-1]).all()
    assert (upper[:, 1:] <= upper[:, :-1]).all()
    assert (lower <= final).all()
    assert (final <= upper).all()
    assert np.array_equal(lower[:, -1:], final)
    assert np.array_equal(upper[:, -1:], final)
    assert decided[:, -1].all()
    agrees = np.broadcast_to(satisfied, violated.shape) == ~violated
    assert agrees[decided].all()
    assert not violated[~decided].any()
    assert np.array_equal(formula.intervals(seen, length)[..., 0], lower[:, :STEPS])


@examples(80)
@given(formulas(), SEEDS)
def test_unbounded_formulas_have_intervals_that_bracket_what_follows(node, seed):
    formula = make(node)
    whole = random_signals(seed, rows=3, steps=STEPS + 14)
    monitor = formula.interval_monitor()
    _, verdicts = follow(monitor, monitor.start(3), whole, range(STEPS + 14))
    lower, upper = column(verdicts, "lower"), column(verdicts, "upper")
    assert (lower[:, 1:] >= lower[:, :-1]).all()
    assert (upper[:, 1:] <= upper[:, :-1]).all()
    assert (lower <= upper).all()
    decided = column(verdicts, "decided")
    assert (decided[:, 1:] >= decided[:, :-1]).all()
    if formula.horizon < STEPS + 14:
        final, satisfied = formula.robustness(whole)[:, :1], formula.satisfied(whole)[:, :1]
        assert np.array_equal(lower[:, -1:], final)
        assert ((lower <= final) & (final <= upper)).all()
        agrees = np.broadcast_to(satisfied, decided.shape) == ~column(verdicts, "violated")
        assert agrees[decided].all()
        assert decided[:, -1].all()


@examples(80)
@given(
    formulas(),
    READINGS,
    SEEDS,
    st.integers(1, STEPS - 1),
    st.sampled_from([Formula.monitor, Formula.interval_monitor]),
)
def test_copies_and_neighbours_change_nothing(node, until, seed, cut, kind):
    signals = random_signals(seed, rows=4)
    monitor, index = kind(make(node, until)), np.array([2, 0, 0])
    state, _ = follow(monitor, monitor.start(4), signals, range(cut))
    copied = batch.concatenate([batch.take(state, index[:1]), batch.take(state, index[1:])])
    later = {name: x[index] for name, x in signals.items()}
    _, after = follow(monitor, copied, later, range(cut, STEPS))
    _, straight = follow(monitor, state, signals, range(cut, STEPS))
    for i, row in enumerate(index):
        one = {name: x[row : row + 1] for name, x in signals.items()}
        _, alone = follow(monitor, monitor.start(1), one, range(STEPS))
        for a, b, c in zip(after, straight, alone[cut:], strict=True):
            for name in vars(a):
                assert getattr(a, name)[i] == getattr(b, name)[row] == getattr(c, name)[0]
