"""Whole rules on situations told by hand."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.driving.geometry import Rectangle, signed_distance

# The ego needs 20 + 8 m less what o needs: 5.2 m behind one of 20.5 m/s, 28 m behind a parked one.
FAR, CLOSE = {"x": 44.0, "speed": 20.0}, {"x": 9.0, "speed": 20.0}
STEP = 0.1
ROAD = Road((-1.75, 1.75, 5.25), 3.5, (0,))


def violations(lab, rule, samples):
    """Return at which samples the body fails, from the margin."""
    state, failed = rule.start(1), []
    for t, signals in enumerate(samples):
        state, _ = rule.update(state, signals)
        if rule.margin(state)[0] < 0.0:
            failed.append(t)
    return failed


class TestSafeDistance:
    def test_far_and_close(self, lab):
        rule = lab.rule("R_G1")
        violated, robustness = lab.judge(rule, FAR)
        needed = 20.0 - 400.0 / 21.0 + 8.0
        assert not violated
        assert robustness == pytest.approx((40.0 - needed) / 10.0)
        violated, robustness = lab.judge(rule, CLOSE)
        assert violated
        assert robustness == pytest.approx((5.0 - needed) / 10.0)

    @pytest.mark.parametrize(
        "other", [{**CLOSE, "y": 5.25}, {**CLOSE, "x": -9.0}, {**CLOSE, "x": 2.0, "y": -1.75}]
    )
    def test_only_ahead_in_the_lane(self, lab, other):
        assert not lab.judge(lab.rule("R_G1"), other)[0]

    def test_parked_vehicles_only_when_asked_for(self, lab):
        parked = {"x": 20.0, "speed": 0.0}
        assert lab.judge(lab.rule("R_G1", 2, moving=[True, False]), FAR, parked) == lab.judge(
            lab.rule("R_G1"), FAR
        )
        assert lab.judge(lab.rule("R_G1", 2, moving=[True, False], vehicles="all"), FAR, parked)[0]

    def test_a_cut_in_exempts_for_three_seconds_and_no_longer(self, lab):
        in_front = {"x": 9.0, "speed": 20.0}
        beside, over = {**in_front, "y": 5.25}, {**in_front, "y": 3.5, "heading": -0.05}
        samples = [lab.signals(o) for o in [beside] * 5 + [over] * 8 + [in_front] * 50]
        # the cut-in begins at sample 5 and excuses up to 3 s = 30 samples later
        assert violations(lab, lab.rule("R_G1"), samples) == list(range(36, 63))
        assert violations(lab, lab.rule("R_G1", cut_in_time=0.3), samples) == list(range(9, 63))
        assert violations(lab, lab.rule("R_G1", cut_in_time=0.0), samples) == list(range(6, 63))

    def test_a_long_cut_in_exempts_only_from_its_beginning(self, lab):
        over = {"x": 9.0, "speed": 20.0, "y": 3.5, "heading": -0.05}
        samples = [lab.signals({**over, "y": 5.25})] + [lab.signals(over)] * 60
        assert violations(lab, lab.rule("R_G1"), samples) == list(range(32, 61))

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


class TestBraking:
    def test_without_a_vehicle_ahead(self, lab):
        for count, others in [(0, []), (1, [{"x": -10.0}]), (1, [{"x": 20.0, "y": 5.25}])]:
            rule = lab.rule("R_G2", count)
            assert lab.judge(rule, *others, acceleration=-3.0)[0]
            assert not lab.judge(rule, *others, acceleration=-1.9)[0]
        assert lab.judge(lab.rule("R_G2", 0), acceleration=-3.0) == (True, pytest.approx(-0.5))

    def test_behind_a_vehicle_that_is_too_near(self, lab):
        assert not lab.judge(lab.rule("R_G2"), CLOSE, acceleration=-8.0)[0]

    def test_behind_a_far_vehicle_that_brakes_too(self, lab):
        rule = lab.rule("R_G2")
        assert lab.judge(rule, FAR, acceleration=-3.0)[0]
        assert not lab.judge(rule, {**FAR, "acceleration": -1.5}, acceleration=-3.0)[0]
        assert lab.judge(rule, {**FAR, "acceleration": -0.5}, acceleration=-3.0)[0]
        assert lab.judge(rule, {**FAR, "acceleration": 5.0}, acceleration=-3.0)[0]

    def test_only_the_nearest_ahead_exempts(self, lab):
        rule = lab.rule("R_G2", 2)
        near_one, standing = {"x": 20.0, "speed": 20.0}, {"x": 26.0, "speed": 0.0}  # 22 m: the ego needs 28
        assert lab.judge(rule, near_one, standing, acceleration=-3.0)[0]
        assert not lab.judge(rule, {**near_one, "x": 34.0}, standing, acceleration=-3.0)[0]

    def test_the_threshold_is_an_option(self, lab):
        assert not lab.judge(lab.rule("R_G2", 0, abrupt_braking=-4.75), acceleration=-4.7)[0]


class TestFlow:
    def test_slow_ego(self, lab):
        rule = lab.rule("R_G4", 0)
        assert lab.judge(rule, speed=21.0) == (True, pytest.approx(-0.11 / 5.0))
        assert lab.judge(rule, speed=21.2) == (False, pytest.approx(0.09 / 5.0))

    def test_a_slow_leader_exempts(self, lab):
        rule = lab.rule("R_G4")
        slow = {"x": 30.0, "speed": 15.0}
        assert lab.judge(rule, slow, speed=15.0) == (False, pytest.approx(6.11 / 5.0))
        assert lab.judge(rule, {**slow, "speed": 22.0}, speed=15.0)[0]
        assert lab.judge(rule, {**slow, "y": 5.25}, speed=15.0)[0]
        assert lab.judge(rule, {**slow, "x": -30.0}, speed=15.0)[0]

    def test_a_parked_leader_exempts_unless_left_out(self, lab):
        parked = {"x": 30.0, "speed": 0.0}
        assert not lab.judge(lab.rule("R_G4", moving=[False]), parked, speed=15.0)[0]
        assert lab.judge(lab.rule("R_G4", moving=[False], vehicles="moving"), parked, speed=15.0)[0]


LEFT = {"x": 0.0, "y": 5.25, "speed": 16.0}


class TestLeftTraffic:
    def test_faster_than_the_left_car(self, lab):
        rule = lab.rule("R_I2")
        assert lab.judge(rule, LEFT) == (True, pytest.approx(-0.4))
        assert not lab.judge(rule, {**LEFT, "speed": 21.0})[0]
        assert not lab.judge(rule, {**LEFT, "x": 10.0})[0]
        assert not lab.judge(rule, {**LEFT, "y": -1.75})[0]

    def test_a_queue_on_the_left_may_be_passed_slowly(self, lab):
        rule = lab.rule("R_I2", 4)
        queue = [{**LEFT, "x": 10.0 * k} for k in range(4)]
        assert not lab.judge(rule, *queue)[0]
        assert lab.judge(rule, *queue, speed=22.0)[0]  # 6 m/s faster
        quick = [*queue[:3], {**queue[3], "speed": 17.0}]
        assert lab.judge(rule, *quick)[0]  # two slow ones ahead do not make a queue
        behind = [*queue[:3], {**queue[3], "x": -10.0}]
        assert lab.judge(rule, *behind)[0]

    def test_from_the_ramp_past_the_carriageway(self, lab):
        rule = lab.rule("R_I2")
        carriageway = {**LEFT, "y": 1.75}
        assert not lab.judge(rule, carriageway, y=-1.75, speed=35.0)[0]
        no_ramp = lab.rule("R_I2", road=Road(lab.road.lane_centres, 3.5))
        assert lab.judge(no_ramp, carriageway, y=-1.75, speed=35.0)[0]

    def test_the_ramp_does_not_exempt_past_a_queue(self, lab):
        rule = lab.rule("R_I2", 4)
        queue = [{**LEFT, "x": 10.0 * k, "y": 1.75} for k in range(4)]
        assert lab.judge(rule, *queue, y=-1.75, speed=35.0)[0]
        assert not lab.judge(rule, *queue, y=-1.75, speed=20.0)[0]


class TestCollision:
    def test_robustness_has_its_sign_and_is_in_metres(self, lab):
        rule = lab.rule("no_collision", 2)
        for x, violated in [(4.3, False), (4.0, True), (3.8, True)]:
            found, robustness = lab.judge(rule, {"x": 50.0}, {"x": x})
            assert found == violated
            assert robustness == pytest.approx(x - 4.0)

    def test_parked_vehicles_count(self, lab):
        assert lab.judge(lab.rule("no_collision", moving=[False]), {"x": 3.0})[0]
        assert not lab.judge(lab.rule("no_collision", moving=[False], vehicles="moving"), {"x": 3.0})[0]

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
        for y, speed, broken in [
            (1.75, 24.0, False),
            (1.75, 26.0, True),
            (5.25, 26.0, False),
            (3.5, 26.0, True),
        ]:
            assert lab.judge(lab.rule("R_G3", 0, **limits), y=y, speed=speed)[0] == broken, (y, speed)

    def test_a_list_must_fit_the_road(self, lab):
        with pytest.raises(UsageError, match="lane_limit has 2 entries, the road 3 lanes"):
            lab.rule("R_G3", 0, lane_limit=(10.0, 20.0))

    def test_view_and_braking_limits_are_the_published_speeds_by_default(self, lab):
        for options, limit in [({"braking_distance": 1e6}, 50.0), ({"field_of_view": 1e6}, 43.0)]:
            rule = lab.rule("R_G3", 0, **options)
            assert lab.judge(rule, speed=20.0)[1] == pytest.approx((limit - 20.0) / 5.0, abs=1e-12)

    def test_the_stopping_distance_at_the_limit_is_the_field_of_view(self, lab):
        rule = lab.rule(
            "R_G3", 0, field_of_view=70.0, ego_braking=7.0, reaction_time=1.1, braking_distance=1e6
        )
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
        rule = lab.rule(
            None, 2, formula="always (ahead(b, ego) -> gap(ego, b) > {cut_in_time})", cut_in_time=7.0
        )
        assert lab.judge(rule, {"x": 5.0}, {"x": 9.0}) == (True, -0.5)  # the least: 0.5 units ahead
        assert not lab.judge(rule, {"x": 5.0}, {"x": 12.0})[0]

    def test_vehicles_left_out_of_others_can_still_be_named(self, lab):
        options = {"moving": [False, True], "vehicles": "moving"}
        rule = lab.rule(None, 2, formula="always (distance(ego, a) > 1)", **options)
        assert rule.names == ("b",)
        assert lab.judge(rule, {"x": 4.5, "speed": 0.0}, {"x": 50.0})[0]

    @pytest.mark.parametrize(
        ("formula", "message", "hint"),
        [
            ("always in_frontof(a, ego)", "no predicate 'in_frontof'", "'in_front_of'"),
            (
                "always in_front_of(a)",
                "in_front_of takes 2 vehicles, not 1",
                "in_front_of(a, b): The rear of a",
            ),
            ("always speed(a, ego) > 3", "speed takes 1 vehicle, not 2", "speed(a)"),
            ("always speed > 3", "'speed' has no vehicle as its argument", "'speed'"),
            ("always speed(egoo) > 3", "no vehicle 'egoo'", "'ego'"),
            ("always speed(others) > 3", "others is a group", "forall"),
            ("forall o in cars: always (speed(o) > 3)", "no group of vehicles 'cars'", "others"),
            ("always (speed(ego) > {speed_limitt})", "{speed_limitt} is not an option", "'speed_limit'"),
        ],
    )
    def test_mistakes_are_named(self, lab, formula, message, hint):
        with pytest.raises(UsageError) as error:
            lab.rule(None, 1, formula=formula)
        assert message in error.value.message
        assert hint in (error.value.hint or "")


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


def test_explain_reads_the_first_row(lab):
    rule = lab.rule("R_I2", 2)
    rows = [lab.signals({}, LEFT), lab.signals(LEFT, {})]
    both = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    assert rule.explain(both) == "R_I2 with vehicle 'b' (robustness -0.4)"


def test_explain_names_the_ego_where_others_only_exempt(lab):
    behind, aside = {"x": -30.0}, {"x": 30.0, "y": 5.25}
    braking = lab.signals(behind, aside, acceleration=-3.0)
    assert lab.rule("R_G2", 2).explain(braking) == "R_G2 by the ego (robustness -0.5)"
    assert lab.rule("R_G4", 0).explain(lab.signals(speed=10.0)) == "R_G4 by the ego (robustness -2.22)"
