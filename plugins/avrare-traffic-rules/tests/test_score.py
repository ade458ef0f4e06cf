"""The order of particles depends neither on the scales of the predicates nor on units."""

import numpy as np
import pytest

import avrare
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request

STEPS = 6
SCALES = {"longitudinal": 1e-2, "lateral": 1.75e-3, "speed": 5e3, "acceleration": 60.0, "heading": 1e-4}
"""Lengths and headings, which ``cut_in`` and ``left_of`` compare among themselves, shrink alike."""
TWO_KINDS = "always (speed(ego) < 24.5 and forall o in others: distance(ego, o) {scale}> {gap})"


class Platoon:
    """The ego follows a car in its lane, and one in the left lane drives beside them."""

    noise_size = 4

    def initial(self, noise):
        return np.zeros((len(noise), 4))

    def step(self, state, noise):
        return 0.7 * state + noise

    def signals(self, state):
        speed, braking, ahead, beside = state.T
        flat = np.zeros(len(state))
        columns = {
            "x": (flat, 30.0 + 3.0 * ahead, flat - 40.0),
            "y": (flat + 1.75, flat + 1.75, flat + 5.25),
            "heading": (flat, flat, flat),
            "speed": (20.0 + speed, 20.0 + ahead, 25.0 + beside),
            "acceleration": (braking - 0.5, flat, flat),
        }
        signals = {f"ego_{name}": ego for name, (ego, *_) in columns.items()}
        return signals | {f"others_{name}": np.stack(rest, 1) for name, (_, *rest) in columns.items()}


def problem(lab, rule, scales=None, score="margin"):
    """Return the problem of a rule by its name, or of a formula."""
    options = {"formula": rule} if "(" in rule else {}
    built = lab.rule(None if options else rule, 2, scales=scales or {}, **options)
    return avrare.Problem(Platoon(), built, STEPS, score)


def simulate(task, rows=60):
    request = Request.from_start(np.zeros(rows, dtype=np.int64), np.arange(rows))
    return task.simulate(NoiseSource(4, 4), request)


@pytest.mark.parametrize("rule", ["R_G1", "R_G2", "R_G3", "R_I1", "R_I2"])
def test_scales_change_no_order(lab, rule):
    one, other = (simulate(problem(lab, rule, scales)) for scales in (None, SCALES))
    np.testing.assert_allclose(one.scores, other.scores, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(one.violated, other.violated)
    assert len(np.unique(one.scores[:, -1])) > 10


def test_an_estimate_keeps_its_bits_in_another_unit(lab):
    """Write one conjunct in metres per second, one in metres or millimetres."""
    texts = [TWO_KINDS.format(scale=scale, gap=gap) for scale, gap in (("", 12.5), ("* 1000 ", 12500))]
    options = {"seed": 3, "runs": 4, "particles": 40, "discard": 4}
    found = [avrare.estimate(problem(lab, text), "ams", **options) for text in texts]
    np.testing.assert_array_equal(found[0].run_probabilities, found[1].run_probabilities)
    assert 0.0 < found[0].probability < 0.05
    raw = [simulate(problem(lab, text, score="robustness")).scores for text in texts]
    assert (np.argsort(raw[0][:, -1]) != np.argsort(raw[1][:, -1])).any()
