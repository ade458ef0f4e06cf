"""Drawn starts, goals, friction and weather: every particle its own, exact where a plan is solved."""

import numpy as np
import pytest
from pydantic import TypeAdapter

from avrare.base.errors import UsageError
from avrare.base.laws import Law
from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.drawn_traffic import with_numbers
from avrare_single_track.simulator import ScriptedTraffic, build

EGO = {"x": 0.0, "y": 1.75, "speed": 20.0, "friction": 1.0}
VEHICLES = [
    {"name": "cruiser", "x": 30.0, "y": 5.25, "speed": 15.0},
    {
        "name": "driven",
        "x": 10.0,
        "y": -1.75,
        "speed": 10.0,
        "drive": {"lanes": [0], "steps": 12, "y_min": -3.0, "y_goal": -1.75, "v_goal": 14.0},
    },
]
LAWS = {
    path: TypeAdapter(Law).validate_python({"law": "normal", "mean": mean, "sd": sd})
    for path, mean, sd in (
        ("ego.speed", 20.0, 1.0),
        ("ego.friction", 1.0, 0.1),
        ("vehicles.0.x", 30.0, 2.0),
        ("vehicles.0.speed", 15.0, 1.0),
        ("vehicles.1.x", 10.0, 2.0),
        ("vehicles.1.speed", 10.0, 0.5),
        ("vehicles.1.drive.v_goal", 14.0, 0.5),
        ("weather", 1.0, 0.1),
    )
}


def simulator(**options):
    return build(SingleTrackConfig.model_validate({"ego": EGO, "vehicles": VEHICLES, **options}))


@pytest.fixture(scope="module")
def drawn():
    return simulator(weather=1.0).drawing(LAWS)


def values(n, seed=0):
    numbers = np.random.default_rng(seed).standard_normal((len(LAWS), n))
    return {path: law.at(row) for (path, law), row in zip(LAWS.items(), numbers, strict=True)}


def roll(sim, world, steps, acceleration=0.0):
    for _ in range(steps):
        n = len(world.ego.x)
        world = sim.step(world, Action(np.full(n, acceleration), np.zeros(n)), np.zeros((n, 0)))
    return world


def check_places(drawn, chosen, car, names, steps, tolerance):
    """Compare the places of a car with those of its own script, for each row of its numbers."""
    rows = len(chosen[f"vehicles.{car}.x"])
    mixture = drawn.drawn_traffic.mix(chosen, rows)
    for row in range(rows):
        numbers = {name: chosen[f"vehicles.{car}.{name}"][row] for name in names}
        script = with_numbers(drawn.config.vehicles[car], numbers)
        exact = ScriptedTraffic((script,), drawn.scene.road, drawn.dt)
        for step in steps:
            found, wanted = drawn.drawn_traffic.at(np.full(rows, step), mixture), exact.at(np.array([step]))
            for name in ("x", "y", "heading", "speed"):
                assert abs(getattr(found, name)[row, car] - getattr(wanted, name)[0, 0]) < tolerance, name


def test_every_particle_has_its_own_start(drawn):
    chosen = values(5)
    world = drawn.reset_drawn(np.zeros((5, 0)), chosen)
    assert (world.ego.speed == chosen["ego.speed"]).all()
    assert (world.friction == chosen["ego.friction"]).all()
    assert (world.weather == chosen["weather"]).all()
    assert world.others.x[:, 1] == pytest.approx(chosen["vehicles.1.x"])
    assert world.others.speed[:, 1] == pytest.approx(chosen["vehicles.1.speed"], abs=1e-9)


def test_vehicles_at_constant_velocity_are_exact(drawn):
    chosen = values(6)
    world = roll(drawn, drawn.reset_drawn(np.zeros((6, 0)), chosen), 20)
    expected = chosen["vehicles.0.x"] + 2.0 * chosen["vehicles.0.speed"]
    assert world.others.x[:, 0] == pytest.approx(expected, abs=1e-9)


def test_planned_vehicles_are_near_their_own_plans(drawn):
    chosen = values(4, seed=2)
    check_places(drawn, chosen, 1, ("x", "speed", "drive.v_goal"), (0, 3, 11, 20), 0.03)


def test_friction_is_each_particle_s_own(drawn):
    chosen = values(3) | {"ego.friction": np.array([1.0, 0.5, 0.2])}
    world = roll(drawn, drawn.reset_drawn(np.zeros((3, 0)), chosen), 1, acceleration=-11.0)
    assert world.ego.acceleration == pytest.approx(-9.81 * chosen["ego.friction"])


def test_too_many_numbers_of_one_script_are_refused():
    names = ("y", "speed", "drive.v_goal", "drive.y_goal")
    with pytest.raises(UsageError, match="at most 3 can be"):
        simulator().drawing({f"vehicles.1.{name}": LAWS["ego.speed"] for name in names})


BENT = {"line": [{"length": 80.0}, {"length": 200.0, "curvature": 0.01}]}


def test_vehicles_at_constant_velocity_are_exact_in_bends():
    vehicle = {"name": "cruiser", "x": 0.0, "y": 5.25, "speed": 15.0, "heading": -0.02}
    laws = {
        f"vehicles.0.{name}": TypeAdapter(Law).validate_python({"law": "normal", "mean": mean, "sd": 1.0})
        for name, mean in (("x", 0.0), ("y", 5.25), ("speed", 15.0))
    }
    drawn = simulator(road=BENT, vehicles=[vehicle]).drawing(laws)
    starts = {"x": [40.0, 0.0, -7.0], "y": [5.25, 4.0, 6.0], "speed": [15.0, 12.0, 18.0]}
    chosen = {f"vehicles.0.{name}": np.array(values) for name, values in starts.items()}
    check_places(drawn, chosen, 0, tuple(starts), (0, 40, 100), 1e-8)
