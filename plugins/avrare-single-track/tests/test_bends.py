"""Bent roads: the plant moves in the plane, scripted vehicles along their lanes."""

from dataclasses import replace

import numpy as np
import pytest

from avrare.driving import Action
from avrare.driving.values import to_plane
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import SingleTrack

ARC = [{"length": 300.0, "curvature": 0.01}]
EGO = {"x": 20.0, "y": 2.0, "speed": 10.0}


def simulator(line=(), vehicles=(), **ego):
    road = {"lane_centres": (0.0, 3.5), "line": line}
    return SingleTrack(SingleTrackConfig(road=road, ego={**EGO, **ego}, vehicles=vehicles))


def drive(sim, steps, yaw_rate, rows=2):
    world = sim.reset(np.zeros((rows, 0)))
    worlds = [world]
    for _ in range(steps):
        world = sim.step(world, Action(np.zeros(rows), np.full(rows, yaw_rate)), np.zeros((rows, 0)))
        worlds.append(world)
    return worlds


def test_the_plane_knows_nothing_of_the_road():
    bent, straight = simulator(ARC), simulator()
    start = to_plane(bent.scene.road, bent.reset(np.zeros((1, 0))).ego)
    same = simulator(x=float(start.x[0]), y=float(start.y[0]), heading=float(start.heading[0]))
    ways = [drive(one, 40, 0.05) for one in (bent, same)]
    for ours, theirs in zip(*ways, strict=True):
        plane = to_plane(bent.scene.road, ours.ego)
        for name in ("x", "y", "heading", "speed"):
            np.testing.assert_allclose(getattr(plane, name), getattr(theirs.ego, name), atol=1e-8)
        np.testing.assert_allclose(ours.steering, theirs.steering, atol=1e-12)
    assert straight.scene.road.line is None


def test_turning_with_the_road_stays_on_it():
    sim = simulator(ARC)
    rate = 10.0 * 0.01 / (1.0 - 0.01 * 2.0)  # along an offset of 2 m inwards
    last = drive(sim, 60, rate)[-1].ego
    assert np.abs(last.y - 2.0).max() < 0.5  # the steering takes a while; straight ahead it would be 16 m
    assert np.abs(last.heading).max() < 0.1


def test_scripted_vehicles_keep_their_lane_and_speed():
    vehicles = ({"name": "a", "x": 10.0, "y": 3.5, "speed": 12.0}, {"name": "p", "x": 50.0, "y": 0.0})
    sim = simulator(ARC, vehicles)
    worlds = [sim.traffic.at(np.full(1, step)) for step in range(50)]
    plane = [to_plane(sim.scene.road, world) for world in worlds]
    x, y = (np.array([getattr(one, name)[0, 0] for one in plane]) for name in ("x", "y"))
    np.testing.assert_allclose(np.hypot(np.diff(x), np.diff(y)), 1.2, rtol=1e-4)  # chords
    assert {float(world.y[0, 0]) for world in worlds} == {3.5}
    assert {float(world.x[0, 1]) for world in worlds} == {50.0}


def test_planned_vehicles_drive_the_lengths_of_their_plan():
    drive_plan = {"lanes": [0, 1], "v_goal": 12.0, "steps": 30, "y_goal": 3.5, "y_min": -0.5, "y_max": 4.0}
    vehicles = ({"name": "a", "x": 10.0, "y": 0.0, "speed": 12.0, "drive": drive_plan},)
    bent, straight = simulator(ARC, vehicles), simulator((), vehicles)
    for step in range(45):
        one, other = (sim.traffic.at(np.full(1, step)) for sim in (bent, straight))
        np.testing.assert_array_equal(one.y, other.y)
        np.testing.assert_array_equal(one.speed, other.speed)
    assert one.x[0, 0] > other.x[0, 0]  # it is on the inner side, where the way is shorter


def test_distances_are_those_of_the_plane():
    sim = simulator(ARC, ({"name": "a", "x": 60.0, "y": 2.0},))
    world = sim.reset(np.zeros((1, 0)))
    chord = 2.0 * 98.0 * np.sin(0.2)  # 0.4 rad of a circle of 98 m
    assert sim.signals(world)["distance"][0, 0] == pytest.approx(chord - 4.298, abs=0.4)  # between corners


def test_an_ego_without_a_place_on_the_road_is_a_fault():
    sim = simulator([{"length": 300.0, "curvature": 0.02}])
    world = sim.reset(np.zeros((2, 0)))
    assert not sim.faults(world).any()
    lost = replace(world, ego=replace(world.ego, x=np.array([20.0, np.nan])))
    later = sim.step(lost, Action(np.zeros(2), np.zeros(2)), np.zeros((2, 0)))
    assert sim.faults(later).tolist() == [False, True]
