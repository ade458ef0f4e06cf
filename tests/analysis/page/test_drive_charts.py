"""Charts beside the animation, on worlds made by hand."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import avrare
from avrare.analysis.failures.noise_free_continuation import Continuations
from avrare.analysis.monitor.monitoring import monitor_recording
from avrare.analysis.page import player
from avrare.analysis.page.causes import draw_map, draw_moment
from avrare.analysis.page.drive_charts import DriveCharts
from avrare.analysis.page.stored_rollouts import MonitoredRollout, StoredRollout
from avrare.driving import Lane, Observation, Road, Scene, Vehicles, World
from avrare.driving.reference_line import CurvedLine, Piece
from avrare.results.recordings import Recording
from avrare.results.stored_causes import StoredKinds
from avrare.rollout.replay import Frame

STEPS = 20


def vehicles(x, y, speed):
    zeros = np.zeros_like(x)
    return Vehicles(x, y, zeros, speed, zeros)


@pytest.fixture
def rollout():
    """Drive an ego at 10 m/s up to a car at rest, seen 0.5 m too far left, and missed at samples 3 to 5."""
    road = Road((-1.75, 1.75), 3.5)
    scene = Scene(0.1, road, 4.0, 2.0, ("van",), np.array([4.0]), np.array([2.0]), np.array([False]))
    frames = []
    for t in range(STEPS + 1):
        ego = vehicles(np.array([1.0 * t]), np.zeros(1), np.full(1, 10.0))
        others = vehicles(np.array([[30.0]]), np.zeros((1, 1)), np.zeros((1, 1)))
        seen = np.array([[t not in (3, 4, 5)]])
        observation = Observation(
            seen, np.where(seen, 30.0, np.nan), np.where(seen, 0.5, np.nan), np.where(seen, 0.0, np.nan)
        )
        world = World(np.array([t]), ego, others, np.zeros(1))
        frames.append(Frame(t, world, observation if t else None))
    gap = np.array([30.0 - t - 4.0 for t in range(STEPS + 1)])
    recording = Recording("t", 0.1, 0.0, {"gap": gap}, scene, scene.names)
    result = monitor_recording("near", avrare.stl("always (gap > 10)", dt=0.1).monitor(), recording)
    ends = np.arange(-1, STEPS + 1)
    found = Continuations(ends, np.where(ends < 12, 1.0, -1.0), ends >= 12, 0.1, len(ends))
    stored = StoredRollout("Worst failure", "near", np.zeros((STEPS + 1, 1)), -4.0, True, 0, 1)
    return MonitoredRollout(stored, result, tuple(frames), "", found)


def test_every_chart_stands_on_the_clock_and_has_both_marks(rollout):
    charts = DriveCharts(rollout, ["van"])
    drawn = charts.draw()
    captions = (
        "Robustness if the noise ended here", "Error of van as seen [m]", "Distance to van [m]",
        "Speed [m/s]", "Acceleration of the ego [m/s²]", "Distance over closing speed, van [s]",
    )  # fmt: skip
    assert {chart.caption for chart in drawn} == set(captions)
    assert all(chart.over_time for chart in drawn)
    for chart in drawn:
        styles = [layer.style for layer in chart.layers]
        assert (styles.count("mark lost"), styles.count("mark")) == (1, 1)
    assert [word for _, word in charts.list_marks()] == ["lost", "violated first"]


def test_what_was_missed_is_shaded_and_errors_are_in_metres(rollout):
    chart = DriveCharts(rollout, ["van"])._draw_errors(0, "van")
    [shade] = [layer for layer in chart.layers if layer.style == "missed"]
    times = [x for x, _ in shade.pieces[0]]
    assert (min(times), max(times)) == pytest.approx((0.25, 0.55))
    assert ("box missed", "missed") in chart.legend


def test_the_distance_is_between_the_boxes(rollout):
    distance = DriveCharts(rollout, ["van"])._distance(0)
    assert distance == pytest.approx([30.0 - t - 4.0 for t in range(STEPS + 1)])


def test_a_moment_from_above_has_all_vehicles(rollout):
    picture = draw_moment(rollout)
    assert [(car.name, car.style) for car in picture.cars] == [("van", "other"), ("ego", "ego")]
    assert picture.title == "The road at 1.6 s, at the first violation"
    worst = dataclasses.replace(rollout, result=dataclasses.replace(rollout.result, first=None))
    assert draw_moment(worst).title == "The road at 2.0 s, at the least robustness"
    assert draw_moment(SimpleNamespace(result=None)) is None


def bent(rollout, road):
    result = rollout.result
    scene = dataclasses.replace(result.recording.scene, road=road)
    recording = dataclasses.replace(result.recording, scene=scene)
    return dataclasses.replace(rollout, result=dataclasses.replace(result, recording=recording))


def test_a_moment_in_a_bend_is_drawn_bent(rollout):
    line = CurvedLine((Piece(500.0, 0.02, 0.02),))  # a circle of 50 m to the left
    picture = draw_moment(bent(rollout, Road((-1.75, 1.75), 3.5, line=line)))
    van, ego = picture.cars  # the ego is 30 m from the left of the picture
    at = 0.02 * (30.0 - 16.0)  # angle on the circle between the ego at 16 m and the van at 30 m
    assert van.x == pytest.approx(30.0 + 50.0 * np.sin(at), abs=0.01)
    assert -van.y == pytest.approx(50.0 * (1.0 - np.cos(at)), abs=0.01)
    assert -van.turn == pytest.approx(np.degrees(at), abs=0.01)
    assert ego.turn == pytest.approx(0.0)
    assert len(picture.lanes) == 2


def test_lanes_that_end_are_drawn_so_far(rollout):
    lanes = tuple(
        Lane(np.array([-100.0, end]), np.full(2, y - 1.75), np.full(2, y + 1.75))
        for y, end in ((-1.75, 20.0), (1.75, 200.0))
    )
    picture = draw_moment(bent(rollout, Road((-1.75, 1.75), 3.5, lanes=lanes)))
    ends = [max(x for x, _ in lane) for lane in picture.lanes]
    assert ends == [pytest.approx(34.0, abs=1.0), pytest.approx(80.0)]


def test_the_player_knows_lanes_that_end_and_what_is_no_lane_of_its_own(rollout):
    lanes = tuple(
        Lane(np.array([-100.0, end]), np.full(2, y - 1.75), np.full(2, y + 1.75))
        for y, end in ((-1.75, 20.0), (1.75, 200.0), (5.25, 200.0))
    )
    road = Road((-1.75, 1.75, 5.25), 3.5, access_ramp=(0,), opposing=(2,), lanes=lanes)
    found = player._tabulate_view(bent(rollout, road).result, rollout.frames, ["van"])["road"]
    assert found["ramp"] == [0, 2]
    assert found["borders"][0] == [[-100.0, 20.0], [-3.5, -3.5], [0.0, 0.0]]
    parallel = dataclasses.replace(road, lanes=(), shoulder=(1,))
    found = player._tabulate_view(bent(rollout, parallel).result, rollout.frames, ["van"])["road"]
    assert (sorted(found["ramp"]), len(found["borders"])) == ([0, 1, 2], 3)


def test_a_player_turns_no_car_round_that_comes_towards_the_ego(rollout):
    frames = list(rollout.frames)
    for t, heading in ((1, np.pi - 0.01), (2, 0.01 - np.pi)):
        others = dataclasses.replace(frames[t].world.others, heading=np.full((1, 1), heading))
        frames[t] = dataclasses.replace(frames[t], world=dataclasses.replace(frames[t].world, others=others))
    [van] = player._tabulate_view(rollout.result, frames, [])["others"]
    assert van["h"][2] - van["h"][1] == pytest.approx(0.02, abs=1e-3)


def test_the_map_has_a_colour_for_each_kind():
    kinds = StoredKinds(
        probability=0.1, kinds=[], points=[[0.0, 0.0], [1.0, 2.0], [3.0, 1.0]], labels=[0, 0, 1]
    )
    picture = draw_map(kinds)
    assert [word for _, word in picture.legend] == ["kind 1", "kind 2"]
    assert [layer.style for layer in picture.layers] == ["dot kind-0", "dot kind-1"]
    assert draw_map(StoredKinds(probability=0.1, kinds=[])) is None
