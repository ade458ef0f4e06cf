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


def at(signals, t):
    return {name: x[:, t].copy() for name, x in signals.items()}


def follow(monitor, state, signals, steps):
    verdicts = []
    for t in steps:
        state, verdict = monitor.update(state, at(signals, t))
        verdicts.append(verdict)
    return state, verdicts


def table(verdicts):
    return [
        np.stack([getattr(v, name) for v in verdicts], axis=1) for name in ("robustness", "violated", "score")
    ]


@pytest.mark.parametrize("text", TEXTS)
def test_copies_are_independent(text):
    """Continue particles copied at a sample: they equal particles that had that history from the start."""
    signals, steps = random_signals(1, 6, 10), 10
    index = np.array([4, 4, 0, 5])
    monitor = FormulaMonitor(stl(text))
    state, before = follow(monitor, monitor.start(6), signals, range(4))
    copied = batch.concatenate([batch.take(state, index[:2]), batch.take(state, index[2:])])
    assert batch.size(copied) == 4
    other = random_signals(2, 4, steps)
    joined = {name: np.concatenate([signals[name][index, :4], other[name][:, 4:]], axis=1) for name in other}
    _, after = follow(monitor, copied, joined, range(4, steps))
    _, whole = follow(monitor, monitor.start(4), joined, range(steps))
    for got, expected in zip(table(after), table(whole), strict=True):
        assert np.array_equal(got, expected[:, 4:])
    again, repeated = follow(monitor, state, signals, range(4, steps))
    _, straight = follow(monitor, monitor.start(6), signals, range(steps))
    assert np.array_equal(table(before + repeated)[0], table(straight)[0])
    assert again.t == steps


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


@pytest.mark.parametrize("text", TEXTS)
def test_rows_do_not_depend_on_their_neighbours(text):
    signals = random_signals(4, 17, 9)
    monitor = FormulaMonitor(stl(text))
    _, together = follow(monitor, monitor.start(17), signals, range(9))
    for i in range(17):
        one = {name: x[i : i + 1] for name, x in signals.items()}
        _, alone = follow(monitor, monitor.start(1), one, range(9))
        for a, b in zip(table(together), table(alone), strict=True):
            assert np.array_equal(a[i], b[0])


@pytest.mark.parametrize("text", TEXTS)
def test_the_state_stops_growing(text):
    signals = random_signals(5, 2, 60)
    monitor = FormulaMonitor(stl(text))
    early, _ = follow(monitor, monitor.start(2), signals, range(10))
    late, _ = follow(monitor, early, signals, range(10, 60))
    held = [sum(leaf.size for leaf in batch.leaves(state)) for state in (early, late)]
    assert held[1] <= held[0]


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
    rng, formula = np.random.default_rng(10), stl(text, warn=False)
    signals = {name: rng.choice(EDGES, size=(300, 11)) for name in "pq"}
    monitor = FormulaMonitor(formula)
    _, verdicts = follow(monitor, monitor.start(300), signals, range(11))
    robustness, violated, _ = table(verdicts)
    for t in range(11):
        prefix = {name: x[:, : t + 1] for name, x in signals.items()}
        assert np.array_equal(robustness[:, t], formula.robustness(prefix)[:, 0])
        assert np.array_equal(violated[:, t], ~formula.satisfied(prefix)[:, 0])
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


def test_only_invariants_have_a_margin():
    for text, has in [
        ("always p", True),
        ("always (p -> once q)", True),
        ("always[0,3] p", False),
        ("always next p", False),
        ("eventually p", False),
        ("not always p", False),
        ("p", False),
    ]:
        monitor = FormulaMonitor(stl(text))
        state, _ = follow(monitor, monitor.start(2), random_signals(6, 2, 3), range(3))
        assert (monitor.margin(state) is not None) == has, text


@pytest.mark.parametrize(
    "text", ["forall o in others: always (gap > p)", "always (forall o in others: gap > p)"]
)
def test_quantified_invariants(text):
    rng = np.random.default_rng(7)
    signals = {"gap": rng.normal(size=(4, 8, 3)), "p": rng.normal(size=(4, 8))}
    inner = (signals["gap"] - signals["p"][..., None]).min(axis=2)
    monitor = FormulaMonitor(stl(text))
    state = monitor.start(4)
    for t in range(8):
        state, verdict = monitor.update(state, at(signals, t))
        assert np.array_equal(monitor.margin(state), inner[:, t])
        assert np.array_equal(verdict.score, -inner[:, : t + 1].min(axis=1))
        assert np.array_equal(verdict.violated, (inner[:, : t + 1] <= 0).any(axis=1))


@pytest.mark.parametrize(
    "text",
    [
        "exists o in others: always (gap > p)",
        "forall o in others: (gap > 0) until[0,4] (gap > p)",
        "(forall o in others: always[0,3] (gap > -1)) and exists o in others: eventually (historically gap)",
        "always (exists o in others: gap since[1,inf] p)",
    ],
)
def test_quantified_formulas_agree_with_offline(text):
    text = text.replace("and exists", "and (exists") + (")" if "and exists" in text else "")
    rng = np.random.default_rng(8)
    signals = {"gap": rng.normal(size=(4, 8, 3)), "p": rng.normal(size=(4, 8))}
    monitor, prefixes = FormulaMonitor(stl(text)), stl(text).prefixes(signals)
    _, verdicts = follow(monitor, monitor.start(4), signals, range(8))
    assert np.array_equal(table(verdicts)[0], prefixes)
    assert np.array_equal(prefixes[:, -1], stl(text).robustness(signals)[:, 0])


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


def test_the_threshold_itself_is_a_violation():
    monitor = FormulaMonitor(stl("always (x < 4)"))
    _, verdict = monitor.update(monitor.start(2), {"x": np.array([4.0, 3.0])})
    assert list(verdict.robustness) == [0.0, 1.0]
    assert list(verdict.violated) == [True, False]


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
