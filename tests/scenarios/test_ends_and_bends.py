"""The planner before a lane's end, and ahead of bends that it is too fast for."""

from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import AvrareError
from avrare.rollout.loaded_scenario import load
from noise_free import noise_free

SCENARIO = """\
name: alone
steps: {steps}
simulator:
  plugin: single_track
  road: {road}
  ego: {{x: 0.0, y: {y}, speed: {speed}, friction: 1.0}}
  vehicles: [{{name: far, x: 2000.0, y: 5.25, speed: 20.0}}]
perception: {{plugin: parametric}}
tracker: {{plugin: imm}}
controller:
  {{plugin: mpc, lanes: {lanes}, y_goal: {goal}, v_goal: {speed}, acceleration_max: {most},
   lateral_acceleration_max: 4.0, turn_rate_weight: 2000.0, turn_rate_change_weight: 150000.0,
   smooth_start: true, speed_min: 0.0, {more}}}
specifications: {{on_road: {{stl: "always (ego_y > -4)"}}}}
"""
LANES = "lane_centres: [-1.75, 1.75, 5.25]"


def drive(road, more, steps=80, y=-1.75, goal=None, speed=24.0, lanes="[0, 1]", most=6.0):
    """Return signals of the rollout without noise."""
    goal = y if goal is None else goal
    ego = {"steps": steps, "y": y, "goal": goal, "speed": speed, "lanes": lanes, "most": most}
    Path("alone.yaml").write_text(SCENARIO.format(road=road, more=more, **ego), encoding="utf-8")
    return noise_free(load("alone.yaml").problem("on_road"))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


ENDING = f"{{{LANES}, lane_spans: [{{lane: 0, begin: -100.0, end: 150.0}}]}}"


def reach_past(signals, end):
    """Return how far the front reaches past the end of the right lane while the ego is in it."""
    inside = signals["ego_y"] - 0.85 < 0.0
    return (signals["ego_x"] + 2.15)[inside].max() - end


def test_the_ego_leaves_a_lane_before_it_ends():
    unaware = drive(ENDING, "lane_ends: false")
    assert reach_past(unaware, 150.0) > 10.0
    signals = drive(ENDING, "lane_ends: true")
    assert reach_past(signals, 150.0) < 0.0
    assert signals["ego_y"][-1] > 0.85
    assert signals["ego_speed"].min() > 15.0


def test_the_ego_stops_where_its_only_lane_ends():
    signals = drive(ENDING, "lane_ends: true", steps=140, lanes="[0]")
    assert reach_past(signals, 150.0) < 0.0
    assert signals["ego_x"][-1] > 135.0
    assert signals["ego_speed"][-1] < 0.5
    assert signals["ego_acceleration"].min() > -6.01


def test_the_ego_stops_in_time_with_weaker_brakes():
    signals = drive(ENDING, "lane_ends: true", steps=140, lanes="[0]", most=3.0)
    assert reach_past(signals, 150.0) < 0.0
    assert signals["ego_acceleration"].min() > -3.01


@pytest.mark.parametrize("aware", ["false", "true"])
def test_lanes_that_a_road_lacks_are_refused(aware):
    with pytest.raises(AvrareError, match="lanes: there is no lane 5, the road has 3 lanes"):
        drive(ENDING, f"lane_ends: {aware}", lanes="[0, 5]")


def test_the_ego_waits_for_a_lane_to_begin():
    road = f"{{{LANES}, lane_spans: [{{lane: 0, begin: 80.0, end: 3000.0}}]}}"
    more = "y_goal_weight: 100.0, "
    first = {}
    for aware in ("false", "true"):
        signals = drive(road, f"{more} lane_ends: {aware}", y=1.75, goal=-1.75)
        first[aware] = signals["ego_x"][signals["ego_y"] < 0.0].min(initial=np.inf)
    assert first["false"] < 40.0
    assert 80.0 < first["true"] < 100.0  # the middle of the ego enters the lane where it is there


PIECES = "{length: 150}, {length: 40, end_curvature: 0.01}, {length: 400, curvature: 0.01}"
BEND = f"{{{LANES}, line: [{PIECES}]}}"


def test_the_ego_slows_down_ahead_of_a_bend():
    lateral = 3.0
    fast = drive(BEND, "wheelbase: 2.391", y=1.75, speed=28.0)
    signals = drive(BEND, f"wheelbase: 2.391, bend_acceleration: {lateral}", y=1.75, speed=28.0, steps=120)
    inside = 100.0 - 1.75
    assert (fast["ego_speed"] ** 2 / inside).max() > 6.0
    bend = signals["ego_x"] > 190.0
    assert bend.any()
    assert (signals["ego_speed"][bend] ** 2 / inside).max() < 1.01 * lateral
    assert signals["ego_speed"][bend].min() > 0.9 * np.sqrt(lateral * inside)
    assert signals["ego_acceleration"].min() > -2.3
    assert signals["ego_speed"][0] == 28.0
