"""Scores of recordings: both series, the first violation, the worst, and who and what decide them."""

import numpy as np
import pytest

import avrare
from avrare.analysis.monitor.monitoring import monitor_recording, summarise
from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.protocols import Specification, Verdict
from avrare.results.recordings import Recording, VehicleTrack, assemble_recording

rng = np.random.default_rng(8)


def recorded(**signals):
    arrays = {name: np.asarray(values, dtype=float) for name, values in signals.items()}
    return Recording("t.csv", 0.1, 0.0, arrays)


class Rule(Specification):
    """A specification over relations of named vehicles, as a plugin makes them."""

    def __init__(self, text, names):
        self.formula = avrare.stl(text, dt=0.1)
        self.names = names
        self.monitor = self.formula.monitor()

    def start(self, n):
        return self.monitor.start(n)

    def update(self, state, signals):
        return self.monitor.update(state, self.sample(signals))

    def sample(self, signals):
        return {f"{name}(others)": values for name, values in signals.items()}


class Bare(Specification):
    """A specification without a formula: x must stay below 3."""

    def start(self, n):
        return np.full(n, np.inf)

    def update(self, state, signals):
        least = np.minimum(state, 3.0 - signals["x"])
        return least, Verdict(least, least < 0.0, -least)


@pytest.mark.parametrize(
    "text",
    [
        "always (x > 0)",
        "always (x > 0 -> once[0:0.5s] (y > 0))",
        "always (x > 0 -> eventually[0:0.5s] (y > 0))",
        "eventually (x > 1 and historically (y > -2))",
        "(x > -1) until[0:2s] (y > 1)",
    ],
)
def test_the_series_are_those_of_the_formula(text):
    formula = avrare.stl(text, dt=0.1)
    signals = {"x": rng.normal(size=50), "y": rng.normal(size=50)}
    found = monitor_recording("f", formula.monitor(), recorded(**signals))
    np.testing.assert_array_equal(found.prefix, formula.prefixes(signals))
    for t in (0, 7, 49):
        seen = {name: values[: t + 1] for name, values in signals.items()}
        assert found.prefix_violated[t] == ~formula.satisfied(seen)[0]
    assert found.robustness == formula.robustness(signals)[0]
    assert (found.body is None) == (not text.startswith("always"))
    assert found.worst is not None
    assert (found.first is not None) == (found.violated and found.pointwise)
    assert found.pointwise == text.startswith("always")


def test_the_body_as_a_batch_is_the_monitor_sample_by_sample_bit_for_bit():
    text = "forall o in others: always (a(o) > 0 -> not once[0:0.4s] (b(o) > 1 and prev c(o) > 0))"
    rule = Rule(text, tuple("uvw"))
    found = monitor_recording("r", rule, recorded(**{name: rng.normal(size=(60, 3)) for name in "abc"}))
    np.testing.assert_array_equal(np.minimum.accumulate(found.body), found.prefix)
    alone = []
    for v, name in enumerate("uvw"):
        one = recorded(**{k: x[:, v : v + 1] for k, x in found.recording.signals.items()})
        alone.append(monitor_recording("r", Rule(text, (name,)), one))
    np.testing.assert_array_equal(np.min([one.body for one in alone], axis=0), found.body)


def test_the_first_and_the_worst_may_be_different_vehicles():
    margin = np.ones((10, 2))
    margin[3, 0], margin[6, 1] = -0.5, -2.0
    rule = Rule("forall o in others: always (safe(o) > 0)", ("car", "van"))
    found = monitor_recording("r", rule, recorded(safe=margin))
    assert (found.first.sample, found.first.vehicles, found.first.robustness) == (3, {"o": "car"}, -0.5)
    assert (found.worst.sample, found.worst.vehicles, found.worst.robustness) == (6, {"o": "van"}, -2.0)
    assert (found.first.formula, found.first.value) == ("safe(car) > 0", -0.5)
    assert (found.worst.formula, found.worst.value) == ("safe(van) > 0", -2.0)
    assert found.prefix_violated.tolist() == [False] * 3 + [True] * 7


def test_the_required_predicate_is_named_although_the_condition_is_nearer():
    close, safe = np.full((5, 2), -1.0), np.full((5, 2), -9.0)
    close[2, 1], safe[2, 1] = 0.1, -3.0
    rule = Rule("forall o in others: always (close(o) > 0 -> safe(o) >= 0)", ("car", "van"))
    found = monitor_recording("r", rule, recorded(close=close, safe=safe))
    assert (found.robustness, found.first.sample) == (-0.1, 2)
    assert (found.first.formula, found.first.value) == ("safe(van) >= 0", -3.0)


def test_a_kept_rule_names_the_part_that_keeps_it():
    close, safe = np.full((5, 2), -1.0), np.full((5, 2), -9.0)
    close[2, 1] = -0.1
    rule = Rule("forall o in others: always (close(o) > 0 -> safe(o) >= 0)", ("car", "van"))
    found = monitor_recording("r", rule, recorded(close=close, safe=safe))
    assert (found.violated, found.robustness, found.worst.sample) == (False, 0.1, 2)
    assert (found.worst.formula, found.worst.value) == ("close(van) > 0", -0.1)


def why(text, dt=0.1, **signals):
    found = monitor_recording("f", avrare.stl(text, dt=dt).monitor(), recorded(**signals)).first
    return found.sample, found.formula, found.value, found.formula_sample


def test_a_later_requirement_is_evaluated_at_its_sample():
    p, q = [1, -1, -1, -1, -1], [0, -3, -4, 2, -1]
    assert why("always (p > 0 -> always[1,2] (q > 0))", 1.0, p=p, q=q) == (0, "q > 0", -3.0, 1)
    assert why("always always[1,1] (x > 0)", 1.0, x=[-7, -1, 1, 1]) == (0, "x > 0", -1.0, 1)
    assert why("always (x < 5 -> next (x > 0))", x=[-7, -1, 1, 1]) == (0, "x > 0", -1.0, 1)
    assert why("always (x > 0 -> once[2,2] (y > 0))", 1.0, x=[0, 0, 0, 9], y=[1, -5, 1, 1])[2:] == (-5.0, 1)


@pytest.mark.parametrize("seed", range(20))
def test_the_value_named_is_the_one_at_the_sample_named(seed):
    draw = np.random.default_rng(seed)
    margin = {name: draw.normal(size=(12, 3)) for name in "abc"}
    text = (
        "forall o in others: always (a(o) > 0.3 -> eventually[1:2] exists p in others: b(p) > 1 and c(o) > 1)"
    )
    found = monitor_recording(
        "r", Rule(text.replace("[1:2]", "[0.1:0.2]"), ("u", "v", "w")), recorded(**margin)
    )
    for moment in filter(None, (found.first, found.worst)):
        if moment.value == -np.inf:  # nothing is ahead of the last sample
            assert (moment.formula[:10], moment.formula_sample) == ("eventually", 11)
            continue
        name, vehicle = moment.formula[0], moment.formula[2]
        index = "uvw".index(vehicle)
        bound = {"a": 0.3, "b": 1.0, "c": 1.0}[name]
        assert moment.value == margin[name][moment.formula_sample, index] - bound
        assert moment.vehicles["o" if name in "ac" else "p"] == vehicle
        assert moment.existential == (("p",) if "p" in moment.vehicles else ())
        if found.violated:
            assert moment.sample + 1 <= moment.formula_sample <= moment.sample + 2
            assert name in "bc"


def test_a_rule_whose_vehicles_are_all_excluded_is_kept():
    rule = Rule("forall o in others: always (safe(o) > 0)", ())
    rule.excluded = ("parked",)
    found = monitor_recording("r", rule, recorded(safe=np.ones((3, 0))))
    assert (found.no_vehicles, found.excluded, found.violated) == (True, ("parked",), False)
    assert not monitor_recording("f", avrare.stl("always (x > 0)").monitor(), recorded(x=[1, 2])).no_vehicles


def test_touching_the_bound_breaks_a_strict_comparison():
    found = monitor_recording("f", avrare.stl("always (x > 0)", dt=0.1).monitor(), recorded(x=[3, 0, 2]))
    assert (found.violated, found.robustness, found.first.sample) == (True, 0.0, 1)


def test_a_specification_without_a_formula():
    found = monitor_recording("bare", Bare(), recorded(x=[1, 2, 4, 5, 1]))
    assert found.prefix.tolist() == [2, 1, -1, -2, -2]
    assert (found.first.sample, found.first.formula, found.worst, found.body) == (2, "", None, None)
    assert monitor_recording("bare", Bare(), recorded(x=[1, 2])).first is None


def test_no_value_is_an_error():
    with pytest.raises(UsageError, match=r"t\.csv: the formula has no value \(NaN\) at 0\.1 s"):
        monitor_recording(
            "f", avrare.stl("always (x - y > 0)").monitor(), recorded(x=[1, np.inf], y=[0, np.inf])
        )


def test_a_road_without_other_vehicles():
    there, states = np.ones(5, dtype=bool), np.zeros((5, 5))
    alone = assemble_recording(
        "t.csv", 0.1, 0.0, VehicleTrack("ego", 4.0, 2.0, there, states), [], Road((0.0,), 3.5)
    )
    formula = avrare.stl("forall o in others: always (distance > 0)", dt=0.1)
    found = monitor_recording("f", formula.monitor(), alone)
    assert (found.violated, found.robustness) == (False, np.inf)
    assert alone.signals["gap"].tolist() == [np.inf] * 5


def test_the_part_that_decides_the_robustness_of_the_whole_is_named():
    # The requirement misses its bound by 2, the condition holds by 0.2 only: the rule's robustness is -0.2.
    drive = recorded(near=[-1.0, 0.1, 0.2], gap=[5.0, -1.5, -2.0])
    result = monitor_recording("rule", avrare.stl("always (near > 0 -> gap > 0)", dt=0.1).monitor(), drive)
    assert (result.robustness, result.worst.formula, result.worst.value) == (-0.2, "gap > 0", -2.0)
    assert result.worst.limit.startswith("near")
    assert ", decided by near" in summarise(result)
