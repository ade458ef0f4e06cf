from functools import partial
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.analysis.page.rates import build_rates
from avrare.base.errors import AvrareError, UsageError
from avrare.driving import Prediction, Road, Scene, Vehicles
from avrare.testing.conformance import Subject, checks_of
from avrare_reference_drivers.config import CruiseConfig, HoldConfig, ReferenceDriverConfig
from avrare_reference_drivers.cruise import build_cruise, build_hold
from avrare_reference_drivers.drivers import DRIVERS, following_distance
from avrare_reference_drivers.reference_driver import build

DT = 0.1
SCENARIO = """
name: cut_in
steps: 60
simulator:
  plugin: single_track
  road: {lane_centres: [0.0, 3.5]}
  ego: {x: 0.0, y: 0.0, speed: 25.0}
  vehicles: [{name: slow, x: 60.0, y: 0.0, speed: 15.0}]
perception: {plugin: parametric}
tracker: {plugin: imm}
controller: {plugin: reference_driver, model: fsm}
specifications: {no_collision: {stl: always (gap > 0)}}
"""


def scene(vehicles=1):
    size = np.full(vehicles, 4.3), np.full(vehicles, 1.9)
    names = tuple(f"car_{k}" for k in range(vehicles))
    road = Road(lane_centres=(0.0, 3.5), lane_width=3.5)
    return Scene(DT, road, 4.3, 1.9, names, *size, np.ones(vehicles, dtype=bool))


def ego(speed, x=0.0, y=0.0):
    speed = np.atleast_1d(np.asarray(speed, dtype=float))
    zeros = np.zeros_like(speed)
    return Vehicles(zeros + x, zeros + y, zeros, speed, zeros)


def ahead(centre, speed, y=0.0):
    times = DT * np.arange(2)
    centre, speed = np.atleast_1d(np.asarray(centre, float)), np.atleast_1d(np.asarray(speed, float))
    return Prediction((centre[:, None] + speed[:, None] * times)[:, None], np.full((len(centre), 1, 2), y))


@pytest.mark.parametrize(
    ("kind", "name", "options"),
    [
        *(("controller", "reference_driver", {"model": model}) for model in DRIVERS),
        ("controller", "reference_driver", {"sees": "track"}),
        *(("controller", name, {}) for name in ("cruise", "hold")),
        ("specification", "avoidable_collision", {}),
    ],
)
def test_conforms(kind, name, options):
    outcomes = [check.run(Subject.find_installed(kind, name, **options)) for check in checks_of(kind)]
    assert outcomes
    assert [(outcome.check, outcome.reason) for outcome in outcomes if outcome.status != "passed"] == []


def drive(controller, speed, centre, other_speed, steps=150):
    # semi-implicit steps, as in JRC's simulator; all rows at once
    n = len(centre)
    memory, x, least = controller.start(n), np.zeros(n), np.full(n, np.inf)
    speed, centre = np.full(n, float(speed)), np.asarray(centre, float).copy()
    braked = []
    for _ in range(steps):
        action, memory = controller.act(memory, ego(speed, x), ahead(centre, np.full(n, float(other_speed))))
        braked.append(action.acceleration)
        speed = np.maximum(speed + action.acceleration * DT, 0.0)
        x, centre = x + speed * DT, centre + other_speed * DT
        least = np.minimum(least, centre - x - 4.3)
    return least, speed, np.array(braked)


def test_the_careful_driver_delays_ramps_and_releases_the_pedal():
    controller = build(ReferenceDriverConfig(model="cc", follows=False, ttc_reading="waits"), scene())
    _, _, braked = drive(controller, 20.0, [4.3 + 15.0], 10.0, steps=20)
    np.testing.assert_allclose(braked[:8, 0], -0.4)
    np.testing.assert_allclose(braked[8:13, 0], -(0.4 + 1.265 * np.arange(1, 6)))
    assert braked.min() == pytest.approx(-0.774 * 9.81)


def test_who_waits_for_two_seconds_collides_and_who_settles_does_not():
    far = [4.3 + 120.0]
    for reading, collides in (("waits", True), ("settled", False)):
        controller = build(ReferenceDriverConfig(model="cc", ttc_reading=reading), scene())
        least, _, _ = drive(controller, 36.0, far, 19.0)
        assert bool(least[0] < 0.0) is collides


@pytest.mark.parametrize("model", DRIVERS)
def test_drivers_end_behind_the_car_ahead_and_never_speed_up(model):
    controller = build(ReferenceDriverConfig(model=model), scene())
    least, speed, braked = drive(controller, 20.0, [4.3 + 60.0], 12.0, steps=400)
    assert least[0] > 0.0
    assert speed[0] <= 12.01
    assert braked.max() <= 0.0


def test_a_vehicle_behind_aside_or_without_a_track_is_no_danger():
    controller = build(ReferenceDriverConfig(model="fsm"), scene())
    for seen in (ahead(-8.0, 30.0), ahead(8.0, 20.0, y=3.5), ahead(np.inf, 0.0)):
        action, _ = controller.act(controller.start(1), ego(20.0), seen)
        assert action.acceleration == pytest.approx(0.0)


def test_cruise_holds_the_speed_of_the_start_or_reaches_its_own_and_its_distance():
    _, speed, braked = drive(build_cruise(CruiseConfig(), scene()), 23.0, [1e5, 1e5], 30.0, steps=50)
    np.testing.assert_allclose(speed, 23.0)
    assert not braked.any()
    controller = build_cruise(CruiseConfig(set_speed=25.0), scene())
    _, speed, braked = drive(controller, 20.0, [1e5], 20.0, steps=300)
    assert speed[0] == pytest.approx(25.0, abs=0.01)
    assert braked.max() <= 1.5
    least, speed, braked = drive(controller, 25.0, [4.3 + 100.0], 15.0, steps=900)
    assert speed[0] == pytest.approx(15.0, abs=0.01)
    assert least[0] == pytest.approx(float(following_distance(np.array(15.0))), abs=0.1)
    assert braked.min() >= -3.0


@pytest.mark.parametrize(("aeb", "collides"), [("null", True), ("{needed_deceleration: 4.0}", False)])
def test_emergency_braking_is_put_into_hold(tmp_path, aeb, collides):
    path = tmp_path / "hold.yaml"
    path.write_text(SCENARIO.replace("perception: {plugin: parametric}\n", ""))
    loop = avrare.load(path, ["controller={plugin: hold}", f"aeb={aeb}"]).stack.loop
    noise = np.zeros((1, loop.noise_size))
    states = [loop.initial(noise)]
    for _ in range(60):
        states.append(loop.step(states[-1], noise))
    assert bool(min(loop.signals(state)["gap"][0] for state in states) < 0.0) is collides


def test_hold_follows_its_path():
    path = ((0.0, 0.0), (40.0, 0.0), (60.0, 10.0), (200.0, 80.0))
    controller = build_hold(HoldConfig(speed=10.0, path=path), scene())
    memory, state = controller.start(1), ego(8.0)
    for _ in range(120):
        action, memory = controller.act(memory, state, None)
        speed, heading = state.speed + DT * action.acceleration, state.heading + DT * action.yaw_rate
        x, y = state.x + DT * speed * np.cos(heading), state.y + DT * speed * np.sin(heading)
        state = Vehicles(x, y, heading, speed, action.acceleration)
    assert state.speed[0] == pytest.approx(10.0)
    assert state.x[0] > 80.0
    assert state.y[0] == pytest.approx(10.0 + 0.5 * (state.x[0] - 60.0), abs=0.2)


def test_drivers_come_back_to_their_lane():
    for heading in (0.0, 0.05):
        controller, state = build_cruise(CruiseConfig(), scene()), ego(20.0, y=0.6)
        state = Vehicles(state.x, state.y, state.heading + heading, state.speed, state.acceleration)
        for _ in range(150):
            action, _ = controller.act(controller.start(1), state, ahead(1e5, 20.0))
            turned = state.heading + DT * action.yaw_rate
            y = state.y + DT * state.speed * np.sin(turned)
            state = Vehicles(state.x, y, turned, state.speed, state.acceleration)
        assert abs(state.y[0]) < 0.02


@pytest.mark.parametrize(("sees", "same"), [("truth", True), ("track", False)])
def test_errors_of_perception_reach_a_driver_who_sees_the_track(tmp_path, sees, same):
    path = tmp_path / "cut_in.yaml"
    path.write_text(SCENARIO)
    loop = avrare.load(path, [f"controller.sees={sees}"]).stack.loop
    noise = np.random.default_rng(1).standard_normal((61, 2, loop.noise_size))
    state = loop.initial(noise[0])
    for row in noise[1:]:
        state = loop.step(state, row)
    assert (state.world.ego.x[0] == state.world.ego.x[1]) == same
    assert (state.world.ego.speed < 25.0).all()


def test_a_driver_who_sees_the_truth_needs_no_tracker(tmp_path):
    path = tmp_path / "cut_in.yaml"
    lines = SCENARIO.splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith(("perception", "tracker"))))
    result = avrare.estimate(avrare.load(path).problem("no_collision"), "mc", rollouts=10, seed=1)
    assert result.probability == 0.0


def test_a_stack_is_compared_with_a_driver_by_name(tmp_path):
    path = tmp_path / "cut_in.yaml"
    path.write_text(SCENARIO.replace("model: fsm", "model: cc, ttc_reading: waits"))
    blind = ["against.perception=null", "against.tracker=null"]
    compare = partial(avrare.compare_versions, path, "reference_driver=fsm")
    same = compare(budget="rollouts=20", overrides=["scenario.controller.model=fsm"])
    assert same.changes[0].verdict(0.95) == "not known"
    crash = ["scenario.simulator.vehicles.0.x=22"]
    late = compare(budget="rollouts=20", overrides=crash + blind)
    assert late.changes[0].verdict(0.95) == "worse"
    assert "0 (at most" in late.changes[0].describe_ratio(0.95)
    rare = compare(estimator="mc:rollouts=30", overrides=[*crash, *blind])
    assert [result.rollouts for result in rare.changes[0].results] == [30, 30]
    assert (rare.changes[0].first, rare.changes[0].second) == (0.0, 1.0)


def test_the_shipped_scene_orders_the_drivers_as_the_grids_do():
    path = Path(__file__).parents[3] / "scenarios" / "motorway_cut_in.yaml"
    fast = ["simulator.draws={}", "simulator.parameters.Closing=10.0"]
    collisions = {}
    for model in ("cc", "reg157", "fsm"):
        driver = [f"controller={{plugin: reference_driver, model: {model}}}", "aeb=null"]
        problem = avrare.load(path, [*fast, *driver]).problem("no_collision")
        assert problem.noise_size == 3  # those of the scene alone: the driver sees the truth
        collisions[model] = avrare.estimate(problem, "mc", rollouts=200, seed=1).failures.count
    assert 0 < collisions["fsm"] < collisions["reg157"] < collisions["cc"]


def test_rates_of_a_catalogue_beside_another_driver(tmp_path):
    (tmp_path / "scene.yaml").write_text(SCENARIO.replace("x: 60.0", "x: 22.0"))
    catalogue = tmp_path / "catalogue.yaml"
    catalogue.write_text(
        "name: two\nbudget: {rollouts: 60}\npilot: 10\nscenes:\n"
        "- {name: near, scenario: scene.yaml, exposure: {per_hour: 2.0, interval: [1.0, 4.0]}}\n"
    )
    rates = avrare.rate(catalogue, against="reference_driver=cc", out=tmp_path / "out")
    [balance] = rates.balances
    assert (rates.driver, balance.ratio, balance.verdict) == ("reference_driver=cc", np.inf, "negative")
    assert balance.describe("cc") in "\n".join(rates.lines()).replace("reference_driver=cc", "cc")
    assert rates.reference.estimates[0]["no_collision"].result.probability == 0.0
    page = avrare.report(rates).read_text()
    assert "negative risk balance" in page
    assert '<span class="interval">reference_driver=cc</span>' in page
    assert " .. " not in page
    assert [build_rates(side).tables[-2].rows[0][2] for side in (rates, rates.reference)] == ["100 %", "–"]
    again = avrare.rate(catalogue, against="reference_driver=cc", out=tmp_path / "out", resume=True)
    assert again.to_dict() == rates.to_dict()
    with pytest.raises(UsageError, match="only a controller can drive"):
        avrare.rate(catalogue, against=str(tmp_path / "scene.yaml"), out=tmp_path / "other")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("reference_driver", "no file, and no controller"),
        ("reference_driver=", "no file, and no controller"),
        ("reference_driver=acc", "controller.model: should be 'cc'"),
        ("driver=fsm", "controller.plugin: unknown controller"),
    ],
)
def test_mistakes_in_the_other_driver_are_named_as_they_were_written(tmp_path, text, words):
    path = tmp_path / "cut_in.yaml"
    path.write_text(SCENARIO)
    with pytest.raises(AvrareError, match=f"^--against {text}: {words}"):
        avrare.compare_versions(path, text)
    with pytest.raises(AvrareError, match=r"^--set against\.controller\.modl: controller\.modl: unknown key"):
        avrare.compare_versions(path, path, overrides=["against.controller.modl=cc"])
