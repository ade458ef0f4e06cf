"""Rules of intersections over simulated traffic: an ego that is driven through CommonRoad scenes.

The scenes and their verdicts, worked out by hand, are those of ``intersection_scenes``: the ego starts where
the first car was and is steered along its lanelets, at the same speed; the others are replayed.
"""

import math

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Action
from avrare.stack.builder import build_rule
from avrare_single_track.file_config import RecordedConfig
from avrare_single_track.recorded import RecordedScene
from intersection_scenes import (
    EGO,
    ENTRY,
    LEFT,
    LENGTH,
    RIGHT_OF_WAY,
    SOUTH,
    crossroads,
    drives,
    route,
    stops,
)

FRONT = ENTRY - 0.5 * LENGTH


@pytest.fixture
def simulate(tmp_path):
    def simulate(cars, **more):
        path = tmp_path / "scene.xml"
        behind = drives(SOUTH, "right", 5.0)  # a scene needs another car: it has no priority over the ego
        path.write_text(crossroads([*cars, behind], **more), encoding="utf-8")
        body = {"length": LENGTH, "width": 1.8, "wheelbase": 2.7}
        way = route(cars[0])
        config = RecordedConfig(file=path, without=(1,), ego=body, route=way, after_impact="go_on")
        return RecordedScene(config)

    return simulate


def drive(sim, rule, accelerations):
    """Return the verdict of an ego that keeps to its way: it turns as the road does."""
    line = sim.scene.road.line
    world, state = sim.reset(np.zeros((1, sim.noise_size))), rule.start(1)
    state, verdict = rule.update(state, sim.signals(world))
    for acceleration in accelerations:
        ego = world.ego
        turn = line.curvature(ego.x + 0.1 * ego.speed) * ego.speed - ego.speed * (0.3 * ego.y + ego.heading)
        world = sim.step(world, Action(np.full(1, acceleration), turn), np.zeros((1, sim.noise_size)))
        assert not sim.faults(world).any()
        state, verdict = rule.update(state, sim.signals(world))
    return bool(verdict.violated[0]), float(verdict.robustness[0]), world


@pytest.mark.parametrize("title", RIGHT_OF_WAY)
def test_right_of_way(simulate, title):
    name, cars, more, kept = RIGHT_OF_WAY[title]
    sim = simulate(cars, **more)
    violated, robustness, _ = drive(sim, build_rule(name, [], sim.scene), np.zeros(78))
    assert violated == (kept is False)
    assert (robustness == math.inf) == (kept is None)


@pytest.mark.parametrize(
    ("before", "standing", "violated"), [(0.5, 36, False), (0.5, 20, True), (2.0, 36, True), (0.5, 0, True)]
)
def test_stop_sign(simulate, before, standing, violated):
    # 5 m/s for 1 s, then at 2.5 m/s^2 to a standstill after 5 m more; it stands, and goes on
    sim = simulate([stops(SOUTH, "straight", FRONT - before, 4.0)], signs={SOUTH: "206"})
    start = float(sim.reset(np.zeros((1, 0))).ego.x[0])
    assert start == pytest.approx(FRONT - before - 10.0, abs=1e-6)
    plan = np.concatenate([np.zeros(10), np.full(20, -2.5), np.zeros(standing), np.full(10, 5.0)])
    assert drive(sim, build_rule("R_IN1", [], sim.scene), plan)[0] == violated


@pytest.mark.parametrize(
    ("lanelets", "message"),
    [
        ((77,), "no lanelet 77"),
        ((103, 101), "the lanelets of `route` do not lead on"),
        ((100, 301, 300), "the lanelets of `route` do not lead on"),
        ((200, 301, 100), "the lanelets of `route` do not lead on"),
        ((311,), "the ego does not start on the way along `route`"),
    ],
)
def test_a_route_that_is_no_way(tmp_path, lanelets, message):
    path = tmp_path / "scene.xml"
    path.write_text(crossroads([EGO, LEFT]), encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        RecordedScene(RecordedConfig(file=path, route=lanelets))


def test_lights_are_signals_that_follow_the_cycle(simulate):
    sim = simulate([EGO], lights="3 green 2 yellow 4 red")
    world = sim.reset(np.zeros((2, 0)))
    seen = [sim.signals(world)["light_0"].tolist()]
    for _ in range(9):
        world = sim.step(world, Action(np.zeros(2), np.zeros(2)), np.zeros((2, 0)))
        seen.append(sim.signals(world)["light_0"].tolist())
    assert seen == [[c, c] for c in (0, 0, 0, 1, 1, 2, 2, 2, 2, 0)]
