"""Systems without a single good rollout, and without noise."""

import numpy as np
import pytest

import avrare
from avrare.base.errors import EveryRolloutBroke, ExitCode
from avrare.testing.faulty_systems import Counting, Fragile, Walk

ESTIMATORS = ["mc", "auto", "is", "smc", "ams", "ess"]


class Late(Walk):
    """Walk that raises at its fifteenth step, or has a NaN from then on: the probe sees ten."""

    def __init__(self, how):
        super().__init__()
        self.how = how

    def initial(self, noise):
        return {**super().initial(noise), "t": np.zeros(len(noise))}

    def step(self, state, noise):
        t = state["t"] + 1.0
        if self.how == "raise" and t[0] == 15:
            raise TypeError("there is no road")
        return {"x": np.where(t < 15, self.move(state["x"], noise), np.nan), "t": t}


@pytest.mark.parametrize("how", ["raise", "nan"])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_an_estimate_in_which_every_rollout_breaks_down_ends_soon(estimator, how):
    system = Counting(Late(how))
    problem = avrare.Problem(system, avrare.stl("always (x < 3)"), steps=20, chunk=200)
    words = "each of the first 200 rollouts ended in an error: "
    with pytest.raises(EveryRolloutBroke, match=words) as caught:
        avrare.estimate(problem, estimator, budget="rollouts=20000")
    assert ("there is no road" if how == "raise" else "NaN in signal x") in caught.value.message
    assert "validate --build" in caught.value.hint
    assert caught.value.exit_code == ExitCode.ROLLOUT_ERRORS
    assert system.rows < 250 * 20 + 200 * 10  # the bisection of a step, and the rows of the last probe


def test_one_good_rollout_in_twenty_goes_on():
    problem = avrare.Problem(Fragile("raise", -1.6), avrare.stl("always (x < 3)"), steps=1)
    with pytest.warns(avrare.HealthWarning, match="errors"):
        result = avrare.estimate(problem, "mc", rollouts=2000)
    assert 1800 < result.errors < 1950


class Still(Walk):
    noise_size = 0

    def move(self, x, noise):
        return x + 0.1


@pytest.mark.parametrize(("limit", "probability"), [(1.0, 1.0), (3.0, 0.0)])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_system_without_noise_has_one_outcome(estimator, limit, probability):
    problem = avrare.Problem(Still(), avrare.stl(f"always (x < {limit})"), steps=20)
    options = {"budget": "rollouts=6000", "suppress": ["all_failed"]}
    if estimator in ("is", "smc"):
        with pytest.raises(avrare.UsageError, match="noise_size is 0"):
            avrare.estimate(problem, estimator, **options)
    else:
        assert avrare.estimate(problem, estimator, **options).probability == pytest.approx(probability)
