"""Options of rules, the road and the vehicles that they are about."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road, Scene
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rule import build

ROAD = Road((-1.75, 1.75, 5.25), 3.5, (0,))


class TestOptionsAndTheRoad:
    @pytest.mark.parametrize("rule", ["R_I4", "R_I5", "R_G1"])
    @pytest.mark.parametrize("shoulder", [[9], [0, 3]])
    def test_a_shoulder_that_the_road_does_not_have(self, lab, rule, shoulder):
        with pytest.raises(UsageError, match=f"shoulder: the road has no lane {shoulder[-1]}") as error:
            lab.rule(rule, shoulder=shoulder)
        assert error.value.hint == "its lanes are 0 to 2, counted from the right"

    def test_a_shoulder_that_the_road_has(self, lab):
        rule = lab.rule("R_I4", 0, shoulder=[2])
        assert not lab.judge(rule)[0]

    @pytest.mark.parametrize("limit", [(), (10.0, 20.0), (10.0, 20.0, None, None)])
    def test_a_limit_for_every_lane(self, lab, limit):
        with pytest.raises(UsageError, match=f"lane_limit has {len(limit)} entries, the road 3 lanes"):
            lab.rule("R_G1", lane_limit=limit)


class TestWhoIsLeftOut:
    def test_parked_vehicles(self, lab):
        rule = lab.rule("R_G1", 3, moving=[True, False, False])
        assert (rule.names, rule.excluded) == (("a",), ("b", "c"))
        assert lab.rule("R_G1", 3, moving=[True, False, False], vehicles="all").excluded == ()

    def test_a_vehicle_that_the_formula_names_is_not_excluded(self, lab):
        formula = "forall o in others: always (distance(o, b) > 1)"
        rule = lab.rule(None, 3, moving=[True, False, False], vehicles="moving", formula=formula)
        assert (rule.names, rule.excluded) == (("a",), ("c",))


class TestNamesThatAreNumbers:
    def rule(self, formula, *names):
        ones = np.ones(len(names))
        scene = Scene(0.1, ROAD, 4.0, 2.0, names, 4.0 * ones, 2.0 * ones, ones > 0.0)
        return build(TrafficRuleConfig(formula=formula), scene)

    def test_numbers_are_prefixed_with_v(self, lab):
        rule = self.rule("always (gap(ego, v7) > 5)", "12", "7")
        assert lab.judge(rule, {"x": 5.0}, {"x": 10.0}) == (False, pytest.approx(1.0))
        assert rule.names == ("12", "7")

    def test_a_vehicle_with_the_prefixed_name_has_precedence(self, lab):
        for names, gap in [(("7", "v7"), 10.0), (("v7", "7"), 5.0)]:
            rule = self.rule("always (gap(ego, v7) > 0)", *names)
            assert lab.judge(rule, {"x": 9.0}, {"x": 14.0})[1] == pytest.approx(gap)

    def test_messages_suggest_prefixed_names(self):
        with pytest.raises(UsageError, match="unknown vehicle 'v71'") as error:
            self.rule("always (gap(ego, v71) > 5)", "17", "car-1")
        assert error.value.hint == "did you mean 'v17'?"
        with pytest.raises(UsageError, match="unknown vehicle 'x'") as error:
            self.rule("always (gap(ego, x) > 5)", "17", "car-1")
        assert error.value.hint == "known: ego, others, v17"


def test_a_rule_needs_a_road():
    with pytest.raises(UsageError, match="needs a driving simulator"):
        build(TrafficRuleConfig(rule="R_G4"), None)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rule": "R_G9"},
        {"rule": None},
        {"formula": "always speed(ego) > 0"},
        {"cut_in": 3},
        {"queue_size": 0},
        {"abrupt_braking": 2.0},
        {"scales": {"speed": 0.0}},
        {"speed_limit": np.inf},
        {"shoulder": [-1]},
        {"shoulder": [0.5]},
        {"lane_limit": 0.0},
        {"lane_limit": -3.0},
        {"lane_limit": [20.0, -3.0, None]},
    ],
)
def test_wrong_options(wrong):
    with pytest.raises(ValueError, match="validation error"):
        TrafficRuleConfig.model_validate({"rule": "R_G1", **wrong})
