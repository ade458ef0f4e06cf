"""Whole rules on situations told by hand, with their values and verdicts as worked out on paper."""

import numpy as np
import pytest

from avrare.driving import Road
from avrare.driving.geometry import Rectangle, signed_distance
from avrare_traffic_rules.rulebook import read_shipped
from traffic_situations import SITUATIONS

# The ego needs 20 + 8 m less what o needs: 5.2 m behind one of 20.5 m/s, 28 m behind a parked one.
FAR, CLOSE = {"x": 44.0, "speed": 20.0}, {"x": 9.0, "speed": 20.0}


def violations(lab, rule, samples):
    """Return at which samples the body fails, from the margin."""
    state, failed = rule.start(1), []
    for t, signals in enumerate(samples):
        state, _ = rule.update(state, signals)
        if rule.margin(state)[0] < 0.0:
            failed.append(t)
    return failed


class TestSafeDistance:
    def test_a_cut_in_exempts_for_three_seconds_and_no_longer(self, lab):
        in_front = {"x": 9.0, "speed": 20.0}
        beside, over = {**in_front, "y": 5.25}, {**in_front, "y": 3.5, "heading": -0.05}
        samples = [lab.signals(o) for o in [beside] * 5 + [over] * 8 + [in_front] * 50]
        # the cut-in begins at sample 5 and excuses up to 3 s = 30 samples later
        assert violations(lab, lab.rule("R_G1"), samples) == list(range(36, 63))
        assert violations(lab, lab.rule("R_G1", cut_in_time=0.3), samples) == list(range(9, 63))
        assert violations(lab, lab.rule("R_G1", cut_in_time=0.0), samples) == list(range(6, 63))

    def test_a_second_cut_in_exempts_again(self, lab):
        in_front = {"x": 9.0, "speed": 20.0}
        over = {**in_front, "y": 3.5, "heading": -0.05}
        cars = [over] * 2 + [in_front] * 8 + [over] * 2 + [in_front] * 8
        rule = lab.rule("R_G1", cut_in_time=0.5)
        assert violations(lab, rule, [lab.signals(o) for o in cars]) == [6, 7, 8, 9, 16, 17, 18, 19]

    def test_a_cut_in_at_the_start_begins_there(self, lab):
        """Try the weak previous: a cut-in that is under way at sample 0 begins there."""
        over = {"x": 9.0, "speed": 20.0, "y": 3.5, "heading": -0.05}
        samples = [lab.signals(over)] * 40
        assert violations(lab, lab.rule("R_G1"), samples) == list(range(31, 40))

    def test_each_vehicle_has_an_exemption_of_its_own(self, lab):
        over = {"x": 9.0, "speed": 20.0, "y": 3.5, "heading": -0.05}
        rule = lab.rule("R_G1", 2)
        assert not lab.judge(rule, over, {**FAR, "x": 60.0})[0]
        assert lab.judge(rule, over, {**CLOSE, "x": 8.0})[0]


class TestCollision:
    def test_robustness_is_the_distance_of_the_rectangles(self, lab):
        signals = lab.random(np.random.default_rng(2), 50, 3)
        found = lab.rule("no_collision", 3).sample(signals)["distance(ego, others)"]
        body = ("x", "y", "heading")
        ego = Rectangle(*(signals[f"ego_{k}"][:, None] for k in body), np.array(4.0), np.array(2.0))
        others = Rectangle(*(signals[f"others_{k}"] for k in body), np.array(4.0), np.array(2.0))
        assert np.array_equal(found, signed_distance(ego, others))


class TestSpeedLimits:
    def test_the_limits_of_every_lane_touched_apply(self, lab):
        limits = {"lane_limit": (10.0, 25.0, None)}
        cases = [(1.75, 24.0, False), (1.75, 26.0, True), (5.25, 26.0, False), (3.5, 26.0, True)]
        for y, speed, broken in cases:
            assert lab.judge(lab.rule("R_G3", 0, **limits), y=y, speed=speed)[0] == broken, (y, speed)

    def test_view_and_braking_limits_are_the_published_speeds_by_default(self, lab):
        for options, limit in [({"braking_distance": 1e6}, 50.0), ({"field_of_view": 1e6}, 43.0)]:
            rule = lab.rule("R_G3", 0, **options)
            assert lab.judge(rule, speed=20.0)[1] == pytest.approx((limit - 20.0) / 5.0, abs=1e-12)

    def test_the_stopping_distance_at_the_limit_is_the_field_of_view(self, lab):
        options = {"field_of_view": 70.0, "ego_braking": 7.0, "reaction_time": 1.1, "braking_distance": 1e6}
        rule = lab.rule("R_G3", 0, **options)
        limit = 20.0 + 5.0 * lab.judge(rule, speed=20.0)[1]
        assert 1.1 * limit + limit**2 / 14.0 == pytest.approx(70.0)


class TestFormulas:
    def test_a_formula_of_the_users_own(self, lab):
        formula = "forall o in others: always (time_to_collision(ego, o) > 1.5)"
        rule = lab.rule(None, 1, formula=formula)
        assert lab.judge(rule, {"x": 24.0, "speed": 10.0}) == (False, pytest.approx(0.5))
        assert lab.judge(rule, {"x": 14.0, "speed": 10.0}) == (True, pytest.approx(-0.5))
        assert rule.names == ("a",)

    def test_a_formula_may_name_vehicles_and_use_definitions_and_parameters(self, lab):
        formula = "always (ahead(b, ego) -> gap(ego, b) > {cut_in_time})"
        rule = lab.rule(None, 2, formula=formula, cut_in_time=7.0)
        assert lab.judge(rule, {"x": 5.0}, {"x": 9.0}) == (True, -0.5)  # the least: 0.5 units ahead
        assert not lab.judge(rule, {"x": 5.0}, {"x": 12.0})[0]

    def test_vehicles_left_out_of_others_can_still_be_named(self, lab):
        options = {"moving": [False, True], "vehicles": "moving"}
        rule = lab.rule(None, 2, formula="always (distance(ego, a) > 1)", **options)
        assert rule.names == ("b",)
        assert lab.judge(rule, {"x": 4.5, "speed": 0.0}, {"x": 50.0})[0]


class TestRulesFile:
    TEXT = """
definitions: |
  # a comment
  behind(a, b) = in_same_lane(a, b) and
    in_front_of(b, a)
rules:
  push: {formula: "forall o in others: always (behind(o, ego) -> gap(o, ego) > 5)"}
  lane: {formula: "forall o in others: always not ahead(o, ego)", vehicles: moving}
"""

    def test_rules_of_the_users_own(self, lab, tmp_path):
        path = tmp_path / "mine.yaml"
        path.write_text(self.TEXT)
        rule = lab.rule("push", 1, rules_file=path)
        assert lab.judge(rule, {"x": -8.0})[0]
        assert not lab.judge(rule, {"x": -10.0})[0]
        lane = lab.rule("lane", 2, rules_file=path, moving=[True, False])
        assert lane.names == ("a",)
        assert lab.judge(lane, {"x": 30.0}, {"x": -30.0})[0]


@pytest.mark.parametrize("definitions", ["recommended", "published"])
@pytest.mark.parametrize(
    ("name", "robustness"),
    [("R_G1", np.inf), ("R_G2", None), ("R_G4", None), ("R_I2", np.inf), ("no_collision", np.inf)],
)
def test_a_road_without_a_ramp_and_other_vehicles(lab, definitions, name, robustness):
    rule = lab.rule(name, 0, road=Road((1.75,), 3.5), definitions=definitions)
    verdict = lab.run(rule, [lab.signals(speed=30.0, acceleration=1.0)] * 4)
    expected = {"recommended": {"R_G2": 1.5, "R_G4": 8.89 / 5.0}, "published": {"R_G2": 3.0, "R_G4": 8.89}}
    assert verdict.robustness[0] == pytest.approx(expected[definitions].get(name, robustness))
    assert not verdict.violated[0]


@pytest.mark.parametrize("moving", [True, False])
def test_explain_names_the_worst_of_all_vehicles(lab, moving):
    rule = lab.rule("R_G1", 4, moving=[True, moving, True, True])
    signals = lab.signals({**FAR, "x": 50.0}, {"x": 20.0, "speed": 0.0}, CLOSE, {"x": -6.0})
    assert f"R_G1 with vehicle {'b' if moving else 'c'!r} (robustness -" in rule.explain(signals)


def test_explain_names_the_ego_where_others_only_exempt(lab):
    behind, aside = {"x": -30.0}, {"x": 30.0, "y": 5.25}
    braking = lab.signals(behind, aside, acceleration=-3.0)
    assert lab.rule("R_G2", 2).explain(braking) == "R_G2 by the ego (robustness -0.5)"
    assert lab.rule("R_G4", 0).explain(lab.signals(speed=10.0)) == "R_G4 by the ego (robustness -2.22)"


IDS = [f"{situation.rule}: {situation.title}" for situation in SITUATIONS]
BOUNDARIES = [situation for situation in SITUATIONS if situation.kind == "boundary"]


@pytest.mark.parametrize("situation", SITUATIONS, ids=IDS)
def test_robustness(situation):
    value, violated = situation.evaluate()
    assert value == pytest.approx(situation.value, abs=1e-9)
    if situation.kind != "boundary":
        assert violated == (situation.kind == "fail")
        assert (value < 0.0) == violated


@pytest.mark.parametrize("situation", BOUNDARIES, ids=[situation.rule for situation in BOUNDARIES])
def test_a_micrometre_across_the_boundary_changes_the_verdict(situation):
    assert abs(situation.evaluate()[0]) < 1e-9
    for amount in (1e-6, -1e-6):
        value, violated = situation.nudged(amount).evaluate()
        assert violated == (amount < 0.0)
        assert np.sign(value) == np.sign(amount)
        assert abs(value) < 1e-4


@pytest.mark.parametrize("rule", read_shipped().rules)
def test_every_rule_has_all_kinds(rule):
    found = {situation.kind for situation in SITUATIONS if situation.rule == rule}
    assert found == {"pass", "fail", "boundary", "exempt"}


def test_titles_of_situations_are_unique():
    assert len(set(IDS)) == len(IDS)
