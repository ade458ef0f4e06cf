"""The lane change in a bend: it drives, and the same scene straight and bent is judged alike."""

from pathlib import Path

import numpy as np
import pytest

from avrare.driving import Vehicles
from avrare.driving.geometry import ego_rectangle, other_rectangles, signed_distance
from avrare.rollout.loaded_scenario import load
from noise_free import noise_free

SCENARIO = Path(__file__).parents[2] / "scenarios" / "lane_change_bend.yaml"


def line(radius):
    k = 1.0 / radius
    pieces = f"{{length: 20}}, {{length: 60, end_curvature: {k}}}, {{length: 400, curvature: {k}}}"
    return f"simulator.road.line=[{pieces}]"


def drive(*overrides):
    """Return signals of the noise-free rollout, and the robustness of every specification."""
    scenario = load(SCENARIO, overrides)
    signals = noise_free(scenario.problem("no_collision"))
    return signals, judge(scenario, signals)


def judge(scenario, signals):
    robustness = {}
    for name, rule in scenario.stack.specifications.items():
        state = rule.start(1)
        for t in range(len(signals["ego_x"])):
            state, verdict = rule.update(state, {key: x[t : t + 1] for key, x in signals.items()})
        robustness[name] = float(verdict.robustness[0])
    return robustness


def bend(signals, *overrides):
    """Return robustness of a straight drive's own ways along a bent road: lanes on the inside are shorter."""
    scenario = load(SCENARIO, overrides)
    scene = scenario.stack.scene

    def along(x, y):
        found = x[:1]
        for t in range(len(x) - 1):
            aside = 0.5 * (y[t : t + 1] + y[t + 1 : t + 2])
            gone = x[t + 1 : t + 2] - x[t : t + 1]
            found = np.append(found, scene.road.line.advance(found[-1:], aside, gone))
        return found

    bent = {**signals, "ego_x": along(signals["ego_x"], signals["ego_y"])}
    columns = zip(signals["others_x"].T, signals["others_y"].T, strict=True)
    bent["others_x"] = np.stack([along(*column) for column in columns], axis=1)
    fields = ("x", "y", "heading", "speed", "acceleration")
    ego, others = (Vehicles(*(bent[prefix + name] for name in fields)) for prefix in ("ego_", "others_"))
    bent["distance"] = signed_distance(ego_rectangle(ego, scene), other_rectangles(others, scene))
    return judge(scenario, {**bent, "gap": bent["distance"].min(axis=1)})


@pytest.mark.slow
def test_straight_and_bent_within_one_per_cent():
    # it changes lanes at once: the moment does not hang on a choice of the planner
    goal = "controller.y_goal=5.25"
    straight, expected = drive("simulator.road.line=[]", goal)
    for radius in (-6000.0, 500.0):
        bent, found = drive(line(radius), goal)
        assert np.abs(bent["ego_y"] - straight["ego_y"]).max() < 0.03
        if abs(radius) > 5000.0:
            assert found == pytest.approx(expected, rel=0.01)
        assert found == pytest.approx(bend(straight, line(radius), goal), rel=0.01), radius


@pytest.mark.slow
def test_it_drives_around_the_bend_and_keeps_its_rules():
    signals, robustness = drive()
    assert min(robustness.values()) > 0.1
    assert signals["ego_y"][0] == 1.75
    assert abs(signals["ego_y"][-1] - 5.25) < 0.5
    bend = signals["ego_speed"][-1] ** 2 / 700.0
    assert signals["lateral_acceleration"][-1] == pytest.approx(bend, rel=0.5)  # it turns with the road
    assert np.abs(signals["lateral_acceleration"]).max() < 5.0
