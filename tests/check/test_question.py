"""What makes two estimates answers to the same question."""

from avrare.check.question import differences, told

OLD = {
    "steps": 40, "simulator": {"plugin": "box", "dt": 0.1, "cars": [{"x": 1.0}, {"x": 2.0}]},
    "perception": {"plugin": "gp"}, "controller": {"plugin": "mpc", "horizon": 8}, "seed": 0,
    "specifications": {"near": {"stl": "always (gap > 2)", "until": "closed", "score": None}},
    "estimator": {"plugin": "mc"}, "thresholds": [],
}  # fmt: skip


def changed(**changes):
    return differences(OLD, {**OLD, **changes}, ["near"])


def test_the_stack_the_estimator_and_the_thresholds_may_change():
    assert changed(controller={"plugin": "other"}, tracker={"plugin": "imm"}, seed=3) == []
    assert changed(estimator={"plugin": "ams"}, thresholds=[1], chunk=5, name="x", confidence=0.9) == []


def test_the_world_the_length_the_perception_and_the_rules_may_not():
    assert changed(steps=41) == ["steps 40 -> 41"]
    assert changed(simulator={**OLD["simulator"], "dt": 0.05}) == ["simulator.dt 0.1 -> 0.05"]
    cars = [{"x": 1.0}, {"x": 3.0}]
    assert changed(simulator={**OLD["simulator"], "cars": cars}) == ["simulator.cars.1.x 2.0 -> 3.0"]
    assert changed(simulator={**OLD["simulator"], "cars": []})[0].startswith("simulator.cars [{")
    assert changed(simulator={**OLD["simulator"], "wet": True}) == ["simulator.wet none -> True"]
    assert changed(perception=None) == ["perception gp -> none"]
    assert changed(perception={"plugin": "other", "x": 1}) == ["perception.plugin gp -> other"]
    rule = {**OLD["specifications"]["near"], "stl": "always (gap > 3)"}
    assert changed(specifications={"near": rule}) == [
        "specifications.near.stl always (gap > 2) -> always (gap > 3)"
    ]


def test_a_score_and_rules_that_only_one_has_are_no_difference():
    rule = {**OLD["specifications"]["near"], "score": "margin"}
    assert changed(specifications={"near": rule, "new": {"stl": "x"}}) == []
    assert changed(specifications={}) == []


def test_long_lists_are_cut():
    assert told(["a", "b"]) == "a, b"
    assert told(list("abcdefg")) == "a, b, c, d, e, and 2 more"
