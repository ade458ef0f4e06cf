"""The online monitor: its state is a value, it costs the same at every sample, and NaN is no violation."""

import math
import warnings
from types import MappingProxyType

import numpy as np
import pytest

from avrare.base import batch
from avrare.base.errors import FormulaError
from avrare.logic import FormulaMonitor, stl

TEXTS = [
    "always (p < 1)",
    "always ((p > 0) -> not once[0,3] (q > 0))",
    "always[0,6] (eventually[0,2] (p > 0))",
    "(p > 0) until[0,5] (q > 0)",
    "always (p > 0 or once[1,2] (q > 0 and historically[1,inf] (not q > 1)))",
    "always ((p > 0) since (q > 0) or (p since[2,inf] q))",
    "eventually (p > 0 and next always (q > 0))",
    "(always p) or not (eventually[2,4] q)",
    "always[0,40] (eventually[0,5] (p > 0))",
    "always[0,7] (historically[2,6] (p < 1) or eventually[3,3] (q <= 0))",
]
TINY = np.finfo(np.float64).tiny
EDGES = np.array([0.0, -0.0, 5e-324, -5e-324, TINY, -TINY, 2 * TINY, 1.0, -1.0, math.inf, -math.inf])


def random_signals(seed, rows, steps, names="pq"):
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=(rows, steps)) for name in names}


def whole_numbers(seed, rows, steps):
    """Return small whole numbers, so that ties and exact thresholds are frequent."""
    rng = np.random.default_rng(seed)
    return {name: rng.integers(-2, 3, (rows, steps)).astype(float) for name in "pq"}


def column(verdicts, name):
    return np.stack([getattr(verdict, name) for verdict in verdicts], axis=1)


def at(signals, t):
    return {name: x[:, t].copy() for name, x in signals.items()}


def follow(monitor, state, signals, steps):
    verdicts = []
    for t in steps:
        state, verdict = monitor.update(state, at(signals, t))
        verdicts.append(verdict)
    return state, verdicts


def table(verdicts):
    return [column(verdicts, name) for name in ("robustness", "violated", "score")]


def check_every_prefix(formula, signals):
    """Compare a monitor with the evaluation of each prefix; return its verdicts."""
    rows, steps = signals["p"].shape
    monitor = FormulaMonitor(formula)
    _, verdicts = follow(monitor, monitor.start(rows), signals, range(steps))
    for t, verdict in enumerate(verdicts):
        seen = {name: x[:, : t + 1] for name, x in signals.items()}
        assert np.array_equal(verdict.robustness, formula.robustness(seen)[:, 0])
        assert np.array_equal(verdict.violated, ~formula.satisfied(seen)[:, 0])
    return verdicts


@pytest.mark.parametrize("text", TEXTS)
def test_inputs_and_earlier_states_are_not_modified(text):
    signals = random_signals(3, 3, 9)
    monitor = FormulaMonitor(stl(text))
    state = monitor.start(3)
    for t in range(9):
        sample = at(signals, t)
        kept = [leaf.copy() for leaf in batch.leaves(state)]
        new, verdict = monitor.update(state, sample)
        assert all(np.array_equal(a, b) for a, b in zip(kept, batch.leaves(state), strict=True))
        for x in sample.values():
            x[:] = math.nan
        assert not np.isnan(verdict.robustness).any()
        assert not any(np.isnan(leaf).any() for leaf in batch.leaves(new))
        state = new


@pytest.mark.parametrize(
    "text",
    [
        "always[0,8] (eventually[0,5] (p > 0))",
        "always (p >= 0 or once[0,3] (q <= 0))",
        "always ((p >= 0) -> not once[0,3] (q > 0))",
        "(p > 0) until[0,7] (q < 0)",
        "eventually[0,3] (p == 0 and q >= 0)",
        "eventually[2,9] (p != 0 and q > 0)",
        "always[0,3] (p > 0 or q >= 0)",
        "(always[0,4] (p > 0)) -> always (q > 0)",
    ],
)
def test_truth_is_exact_where_robustness_is_zero(text):
    """Try zeros of either sign and margins of 0, below strict comparisons, weak ones, and both."""
    rng = np.random.default_rng(10)
    signals = {name: rng.choice(EDGES, size=(300, 11)) for name in "pq"}
    robustness, violated, _ = table(check_every_prefix(stl(text, warn=False), signals))
    assert {True, False} == set(violated[robustness == 0.0])


@pytest.mark.parametrize("text", ["p > 0", *TEXTS])
def test_the_score_is_the_greatest_danger_so_far(text):
    """Leave out NaN; a row with NaN or 0 changes nothing for its neighbours."""
    signals = random_signals(11, 40, 14)
    monitor = FormulaMonitor(stl(text))
    _, clean = follow(monitor, monitor.start(40), signals, range(14))
    signals["p"][::4, 3], signals["p"][1::4, 0], signals["p"][2::4, 5] = math.nan, math.nan, 0.0
    _, mixed = follow(monitor, monitor.start(40), signals, range(14))
    assert np.isnan(table(mixed)[0]).any()
    for verdicts in (clean, mixed):
        robustness, _, score = table(verdicts)
        danger = np.concatenate([np.full((40, 1), -math.inf), -robustness], axis=1)
        assert np.array_equal(score, np.fmax.accumulate(danger, axis=1)[:, 1:])
    for a, b in zip(table(clean), table(mixed), strict=True):
        assert a[3::4].tobytes() == b[3::4].tobytes()


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
    formula, signals = stl(words, until=until, warn=False), whole_numbers(11, 20, 25)
    verdicts = check_every_prefix(formula, signals)
    assert np.array_equal(formula.prefixes(signals), column(verdicts, "robustness"))


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
    "(always (p -> eventually q)) and always ((eventually q) iff p)",
]


@pytest.mark.parametrize("until", ["closed", "half-open"])
@pytest.mark.parametrize("words", WIDE)
def test_wide_windows_equal_the_evaluation_of_every_prefix(words, until):
    """Cross the widths at which a monitor changes its ways; rows alone give the same bits."""
    formula, signals = stl(words, until=until, warn=False), random_signals(13, 3, 70)
    verdicts, monitor = check_every_prefix(formula, signals), FormulaMonitor(formula)
    _, alone = follow(monitor, monitor.start(1), {name: x[1:2] for name, x in signals.items()}, range(70))
    for name in ("robustness", "violated", "score"):
        assert np.array_equal(column(verdicts, name)[1], column(alone, name)[0])


@pytest.mark.parametrize("words", UNBOUNDED)
def test_a_step_does_not_grow_with_time(words):
    """Check that what is carried stops growing: a step has the same work at every sample."""
    signals = whole_numbers(12, 2, 80)
    for monitor in (FormulaMonitor(stl(words, warn=False)), stl(words, warn=False).interval_monitor()):
        state, _ = follow(monitor, monitor.start(2), signals, range(15))
        sizes = set()
        for t in range(15, 80):
            state, _ = monitor.update(state, at(signals, t))
            sizes.add(sum(leaf.nbytes for leaf in batch.leaves(state)))
        assert len(sizes) == 1
        assert sizes.pop() < 10_000


def test_only_invariants_have_a_margin():
    texts = dict.fromkeys(["always p", "always (p -> once q)"], True)
    texts |= dict.fromkeys(["always[0,3] p", "always next p", "eventually p", "not always p", "p"], False)
    for text, has in texts.items():
        monitor = FormulaMonitor(stl(text))
        state, _ = follow(monitor, monitor.start(2), random_signals(6, 2, 3), range(3))
        assert (monitor.margin(state) is not None) == has, text


def test_nan_is_neither_violation_nor_progress():
    monitor = FormulaMonitor(stl("always (x < 4)"))
    state, verdict = monitor.update(monitor.start(2), {"x": np.array([1.0, 1.0])})
    state, verdict = monitor.update(state, {"x": np.array([math.nan, 5.0])})
    state, verdict = monitor.update(state, {"x": np.array([9.0, 1.0])})
    assert np.isnan(verdict.robustness[0])
    assert list(verdict.violated) == [False, True]
    assert list(verdict.score) == [-3.0, 1.0]


@pytest.mark.parametrize("bad", range(9))
@pytest.mark.parametrize(
    "text",
    ["always[0,40] (eventually[0,3] p)", "always (eventually[1,4] p)", "always (p or eventually[0,3] p)"],
)
def test_nan_stays_in_windows_ahead(text, bad):
    """Keep a value NaN for good that is not settled yet and depends on a NaN."""
    monitor = FormulaMonitor(stl(text))
    p = random_signals(9, 2, 12)["p"]
    p[0, bad] = math.nan
    _, verdicts = follow(monitor, monitor.start(2), {"p": p}, range(12))
    missing = np.isnan(table(verdicts)[0])
    depends = bad > 0 or "[1,4]" not in text
    assert not missing[1].any()
    assert not missing[0, :bad].any()
    assert list(missing[0, bad:]) == [depends] * (12 - bad)


@pytest.mark.parametrize(
    "text", ["always (p - q > 0)", "always (p > 1e300)", "always (p iff q)", "always (p < q)"]
)
def test_infinite_and_huge_samples_cause_no_warnings(text):
    monitor = FormulaMonitor(stl(text, warn=False))
    huge = np.array([math.inf, -math.inf, -1.7e308, 1.7e308, math.nan])
    signals = {"p": np.repeat(huge, 5), "q": np.tile(huge, 5)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        state, _ = monitor.update(monitor.start(25), signals)
        _, verdict = monitor.update(state, signals)
    unknown = np.isnan(signals["p"]) | (np.isnan(signals["q"]) & ("q" in monitor.formula.signals))
    assert np.isnan(verdict.robustness[unknown]).all()
    assert not verdict.violated[unknown].any()


def test_samples_of_other_types_are_accepted():
    """Give whole numbers, strided arrays and mappings that are no dict."""
    monitor, whole = FormulaMonitor(stl("always (p < q)")), np.arange(12).reshape(4, 3)
    plain = {"p": whole[:, 0].astype(float), "q": whole[:, 2].astype(float) - 2.0}
    for sample in (plain, {"p": whole[:, 0], "q": plain["q"]}, MappingProxyType(plain)):
        _, verdict = monitor.update(monitor.start(4), sample)
        assert verdict.robustness.dtype == np.float64
        assert list(verdict.robustness) == [0.0] * 4
        assert verdict.violated.all()


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ({}, "'x' is missing"),
        ({"x": np.zeros(3)}, "expected"),
        ({"x": np.array(1.0)}, "expected"),
        ({"x": np.zeros((2, 3))}, "trailing"),
        ({"x": [1.0, 2.0]}, "must be a NumPy array"),
    ],
)
def test_unfit_samples_are_refused(signals, message):
    monitor = FormulaMonitor(stl("always (x < 4)"))
    with pytest.raises(FormulaError, match=message):
        monitor.update(monitor.start(2), signals)
