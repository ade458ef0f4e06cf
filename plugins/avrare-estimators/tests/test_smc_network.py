"""Networks and potentials of sequential Monte Carlo: what they learn, and what they leave alone."""

import tracemalloc

import numpy as np

from avrare_estimators.smc import network as network_module
from avrare_estimators.smc.network import Examples, fit
from avrare_estimators.smc.potentials import Paths, learn


def test_the_network_learns_a_known_committor():
    """Learn, from x at one of two steps, the chance that x plus fresh noise exceeds a bound."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((6000, 2)).cumsum(axis=1)
    end = x[:, 1] + rng.standard_normal(6000)
    features = np.stack([x, x], axis=2)
    examples = Examples(features, end[:, None] > 2.5, np.ones(6000), np.arange(6000) % 5 == 0)
    network = fit(examples, (1,))
    at = np.array([[-1.0, -1.0], [1.0, 1.0], [2.5, 2.5]])
    found = network.probabilities(1, at)[:, 0]
    assert abs(found[2] - 0.5) < 0.12
    assert abs(found[1] - 0.067) < 0.04
    assert found[0] < 0.01
    assert abs(network.probabilities(0, at)[1, 0] - 0.144) < 0.05
    again = fit(examples, (1,))
    assert all(map(np.array_equal, network.layers, again.layers))
    # A row's bits do not depend on its company.
    assert np.array_equal(network.probabilities(1, at)[1:2], network.probabilities(1, at[1:2]))


def test_rows_are_evaluated_in_blocks(monkeypatch):
    """Give the bits of a single block, in memory that does not grow with the rows but for the answer."""
    rng = np.random.default_rng(5)
    features = rng.standard_normal((2 * network_module._BLOCK, 2, 2))
    examples = Examples(features, features[:, 1, :1] > 1.0, np.ones(len(features)), features[:, 0, 0] > 1.0)
    monkeypatch.setattr(network_module, "_MOST_STEPS", 300)
    network, rows = fit(examples, (1,)), features.reshape(-1, 2)
    tracemalloc.start()
    found = network.probabilities(1, rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < found.nbytes + 1500 * network_module._BLOCK
    monkeypatch.setattr(network_module, "_BLOCK", len(rows))
    assert np.array_equal(found, network.probabilities(1, rows))


def test_features_that_tell_nothing_give_no_gain():
    rng = np.random.default_rng(4)
    features = rng.standard_normal((3000, 3, 2))
    violated = rng.random(3000) < 0.05
    score = np.where(violated, 1.0, rng.random(3000))
    paths = Paths(features, score, violated, np.ones(3000), np.arange(3000))
    # The last feature is the score so far, below all levels.
    paths.features[:, :, -1] = -9.0
    found = learn([paths], (2,))
    assert found is not None
    assert found.useful == []
