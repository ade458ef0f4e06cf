"""The simulator as a whole: options, reset, step, signals, faults."""

import copy

import numpy as np
import pytest

from avrare.base.batch import leaves
from avrare.base.errors import UsageError
from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build

VEHICLES = [
    {"name": "parked", "x": 60.0, "y": 1.75},
    {"name": "moving", "x": 30.0, "y": 5.25, "speed": 15.0, "heading": 0.02},
    {
        "name": "driven",
        "x": 10.0,
        "y": -1.75,
        "speed": 10.0,
        "drive": {"lanes": [0], "steps": 10, "y_min": -3.0},
    },
]


@pytest.fixture(scope="module")
def sim():
    options = {"road": {"access_ramp": [0]}, "vehicles": VEHICLES, "after_impact": "go_on"}
    return build(SingleTrackConfig.model_validate({"ego": EGO, **options}))


def start(sim, n):
    return sim.reset(np.zeros((n, 0)))


def actions(rng, n):
    return Action(rng.normal(0.0, 4.0, n), rng.normal(0.0, 0.3, n))


def same(a, b):
    return all(np.array_equal(p, q, equal_nan=True) for p, q in zip(leaves(a), leaves(b), strict=True))


def test_scene(sim):
    assert sim.noise_size == 0
    assert sim.scene.names == ("parked", "moving", "driven")
    assert sim.scene.moving.tolist() == [False, True, True]
    assert sim.scene.road.access_ramp == (0,)
    assert sim.scene.dt == sim.dt == 0.1


def test_signals(sim):
    world = start(sim, 4)
    signals = sim.signals(world)
    fields = ("x", "y", "heading", "speed", "acceleration")
    levels = {f"{name}_acceleration" for name in ("longitudinal", "lateral", "combined")}
    levels |= {"jerk", "time_to_collision", "distance", "gap"}
    assert levels | {f"{who}_{name}" for who in ("ego", "others") for name in fields} == signals.keys()
    for name, values in signals.items():
        assert values.shape == ((4, 3) if name.startswith("others") or name == "distance" else (4,)), name
        assert values.dtype == np.float64
    assert signals["distance"][0, 0] == pytest.approx(60.0 - 4.298)
    assert np.array_equal(signals["gap"], signals["distance"].min(axis=1))
    ramp = np.hypot(10.0 - 4.298, 3.5 - 1.674)
    assert signals["gap"][0] == pytest.approx(ramp)


def test_a_step_moves_everyone_once(sim):
    rng = np.random.default_rng(1)
    world = start(sim, 5)
    for t in range(1, 15):
        before = copy.deepcopy(world)
        after = sim.step(world, actions(rng, 5), np.zeros((5, 0)))
        assert same(world, before)  # the old world is left alone
        assert (after.step == t).all()
        assert np.array_equal(after.ego.acceleration, (after.ego.speed - world.ego.speed) / 0.1)
        change = (after.others.speed - world.others.speed) / 0.1
        np.testing.assert_allclose(after.others.acceleration, change, atol=1e-9)
        np.testing.assert_allclose(after.others.x[:, 1], 30.0 + 1.5 * t * np.cos(0.02), atol=1e-12)
        world = after


@pytest.mark.parametrize("broken", [(np.nan, 0.0), (0.0, np.nan)])
def test_an_action_without_a_value_is_a_fault_of_its_row(sim, broken):
    asked = Action(np.array([0.0, broken[0]]), np.array([0.0, broken[1]]))
    world = sim.step(start(sim, 2), asked, np.zeros((2, 0)))
    assert sim.faults(world).tolist() == [False, True]


def test_without_a_controller_is_a_usage_error(sim):
    with pytest.raises(UsageError, match="needs a controller"):
        sim.step(start(sim, 1), None, np.zeros((1, 0)))


EGO = {"x": 0.0, "y": 1.75, "speed": 20.0}
LEAD = {"name": "lead", "x": 0, "y": 0, "speed": 9.0}
BRAKE = {"from_step": 9, "to_step": 3, "acceleration": -2.0}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"ego": {**EGO, "speed": 50.0}}, "speed must not be above speed_max"),
        ({"ego": {**EGO, "speed": -1.0}}, "greater than or equal to 0"),
        ({"ego": {**EGO, "x": float("nan")}}, "finite"),
        ({"ego": {**EGO, "speed_max": float("inf")}}, "finite"),
        ({"ego": {**EGO, "colour": "red"}}, "Extra inputs"),
        ({"road": {"lane_centres": [1.75, -1.75]}}, "must ascend"),
        ({"road": {"lane_centres": [0.0, 3.0]}}, "lanes overlap"),
        ({"road": {"lane_centres": []}}, "at least 1"),
        ({"road": {"access_ramp": [3]}}, "access_ramp must name lanes 0..2"),
        ({"vehicles": [{"name": "a", "x": 0, "y": 0}] * 2}, "a name of its own"),
        ({"vehicles": [{"name": "ego", "x": 0, "y": 0}]}, "'ego' is a reserved name in formulas"),
        ({"vehicles": [{"name": "others", "x": 0, "y": 0}]}, "'others' is a reserved name in formulas"),
        ({"vehicles": [{**LEAD, "drive": {"lanes": [1, 3]}}]}, "'lead' drives on lane 3, the lanes are 0..2"),
        ({"vehicles": [{**LEAD, "driver": {"lanes": [-1, 2]}}]}, "greater than or equal to 0"),
        ({"vehicles": [{**LEAD, "driver": {"lanes": [2, 0]}}]}, "first lane must not be above the last one"),
        ({"vehicles": [{**LEAD, "driver": {"brake": [BRAKE]}}]}, "from_step must not be above to_step"),
        ({"ego": {**EGO, "width": 0.0}}, "greater than 0"),
        ({"road": {"lane_spans": [{"lane": 0}]}}, "give begin, end or both"),
        ({"road": {"lane_spans": [{"lane": 0, "begin": 5.0, "end": 5.0}]}}, "must begin before it ends"),
        ({"road": {"lane_spans": [{"lane": 7, "end": 5.0}]}}, "lane_spans must name lanes"),
        (
            {"road": {"lane_spans": [{"lane": 0, "end": 5.0}, {"lane": 0, "begin": 9.0}]}},
            "a lane twice",
        ),
        ({"road": {"opposing": [0, 2]}}, "side by side"),
    ],
)
def test_wrong_options_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        SingleTrackConfig.model_validate({"ego": EGO, **wrong})
