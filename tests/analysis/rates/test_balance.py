"""Risk balance: the ratio of two rates with the same exposures."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from avrare.analysis.rates.balance import weigh
from avrare.analysis.rates.combination import Quantity, combine, from_count, from_rollouts


def balance(exposures, failures, others, rollouts=2000):
    terms = []
    for counts in (failures, others):
        parts = [from_rollouts(count, rollouts, 0, 0.95, False) for count in counts]
        results = [SimpleNamespace(probability=p.value, interval=(p.low, p.high)) for p in parts]
        terms.append((combine(exposures, parts), results))
    return weigh("no_collision", "hour", exposures, *terms)


def test_a_common_exposure_of_one_scene_cancels():
    sure = balance([Quantity(3.0, 3.0, 3.0)], [40], [100])
    unsure = balance([Quantity(3.0, 0.5, 18.0)], [40], [100])
    assert sure.ratio == unsure.ratio == pytest.approx(0.4)
    assert sure.interval == pytest.approx(unsure.interval)
    assert sure.verdict == "positive"
    assert "0.4 (0.28 .. 0.57) times as often as fsm: positive risk balance" in sure.describe("fsm")


def test_exposures_matter_where_scenes_have_unlike_shares():
    wide = [Quantity(1.0, 0.2, 5.0), Quantity(1.0, 1.0, 1.0)]
    alike, unlike = balance(wide, [40, 40], [80, 80]), balance(wide, [70, 10], [10, 150])
    assert unlike.ratio == alike.ratio == pytest.approx(0.5)
    assert np.ptp(np.log(unlike.interval)) > 2.0 * np.ptp(np.log(alike.interval))


def test_nothing_is_claimed_without_failures():
    known = [Quantity(1.0, 1.0, 1.0)]
    neither = balance(known, [0], [0])
    assert math.isnan(neither.ratio)
    assert neither.verdict == "not known"
    assert neither.describe("fsm").endswith(" per hour")
    assert balance(known, [0], [30]).verdict == "positive"
    assert balance(known, [30], [0]).verdict == "negative"
    assert balance(known, [0], [1]).verdict == "not known"
    assert neither.to_dict()["ratio"] is None


def test_the_interval_covers():
    rng = np.random.default_rng(2)
    met, chances = np.array([4.0, 1.0]), np.array([[0.01, 0.03], [0.02, 0.01]])
    truth = (met @ chances[0]) / (met @ chances[1])
    covered = 0
    for _ in range(400):
        exposures = [from_count(int(rng.poisson(10.0 * rate)), 10.0, 0.95) for rate in met]
        low, high = balance(exposures, *rng.binomial(2000, chances)).interval
        covered += low <= truth <= high
    assert covered >= 0.93 * 400
