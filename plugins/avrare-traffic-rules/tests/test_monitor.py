"""A rule's monitor: equal to its formula offline, copied by value, with the body's margin."""

import numpy as np
import pytest

from avrare.base.batch import take
from avrare_traffic_rules.rulebook import read_shipped

N, T, V = 8, 50, 4
VERDICT = ("robustness", "violated")
LOOKS_AHEAD = {"R_I5", "R_IN3", "R_IN4", "R_IN5"}
EVERY = pytest.mark.parametrize("name", read_shipped().rules)
DEFINITIONS = pytest.mark.parametrize("definitions", ["recommended", "published"])


def follow(rule, samples, n):
    """Return robustness, violated and margin (n, T), and the states after each sample."""
    state, states, verdicts, margins = rule.start(n), [], [], []
    for signals in samples:
        state, verdict = rule.update(state, signals)
        states.append(state)
        verdicts.append(verdict)
        margins.append(rule.margin(state))
    robustness, violated = (np.stack([getattr(v, name) for v in verdicts], 1) for name in VERDICT)
    return robustness, violated, None if margins[-1] is None else np.stack(margins, 1), states


@pytest.fixture
def traffic(lab):
    rng = np.random.default_rng(4)
    return [lab.random(rng, N, V) for _ in range(T)]


@EVERY
@DEFINITIONS
def test_online_equals_offline_on_traffic(lab, name, definitions, traffic):
    rule = lab.rule(name, V, definitions=definitions)
    robustness, violated, margin, _ = follow(rule, traffic, N)
    samples = [rule.sample(signals) for signals in traffic]
    trace = {key: np.stack([sample[key] for sample in samples], axis=1) for key in rule.formula.signals}
    assert np.array_equal(robustness, rule.formula.prefixes(trace))
    assert np.array_equal(robustness[:, -1], rule.formula.robustness(trace)[:, 0])
    for t in (0, 1, 30, T - 1):
        seen = {key: values[:, : t + 1] for key, values in trace.items()}
        assert np.array_equal(violated[:, t], ~rule.formula.satisfied(seen)[:, 0])
    assert (margin is None) == (name in LOOKS_AHEAD)
    if margin is not None:
        assert np.array_equal(np.minimum.accumulate(margin, axis=1), robustness)
        assert len(np.unique(margin)) > N * T // 4


@EVERY
def test_a_copied_particle_carries_its_past(lab, name, traffic):
    rule = lab.rule(name, V)
    robustness, _, _, states = follow(rule, traffic, N)
    chosen = np.array([5, 5, 2])
    state = take(states[20], chosen)
    for t in range(21, T):
        state, verdict = rule.update(state, take(traffic[t], chosen))
        assert np.array_equal(verdict.robustness, robustness[chosen, t])


@EVERY
def test_signals_are_not_modified(lab, name, traffic):
    before = {key: values.copy() for key, values in traffic[0].items()}
    rule = lab.rule(name, V)
    rule.update(rule.start(N), traffic[0])
    assert all(np.array_equal(before[key], traffic[0][key]) for key in before)
