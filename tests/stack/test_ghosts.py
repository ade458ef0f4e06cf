"""Stacks with false detections: what they need, and that their rollouts keep the promises of all rollouts."""

from pathlib import Path

import numpy as np
import pytest

from avrare.cli.main import main
from avrare.driving import Scene
from avrare.rollout.loaded_scenario import load
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
GHOSTS = "perception.ghosts={rate: 0.5, persistence: 0.4, forward: [5, 40]}"
ASSOCIATE = "tracker.association=hungarian"


def test_a_tracker_that_is_told_the_vehicle_is_refused(capsys):
    assert main(["validate", "--build", LANE_CHANGE, "--set", GHOSTS]) == 4
    error = capsys.readouterr().err
    assert "tracker: it is told which vehicle each detection is of" in error
    assert "association: hungarian" in error


def test_what_ghosts_lack_is_said_at_its_place(capsys):
    assert main(["validate", LANE_CHANGE, "--set", "perception.ghosts={rate: 4}", "--set", ASSOCIATE]) == 4
    assert "4 false detections in a frame need 8 slots or more" in capsys.readouterr().err


def test_the_controller_is_built_for_all_tracks():
    loop = load(LANE_CHANGE, (GHOSTS, ASSOCIATE)).stack.loop
    known: Scene = loop.tracker.known_scene
    assert len(known.names) == 3 + 4
    state = loop.initial(np.zeros((2, loop.noise_size)))
    assert loop.tracker.predict(state.track, 2).x.shape == (2, 7, 3)
    assert loop.noise_size == 12 + 3 * 5


@pytest.mark.slow
def test_rollouts_with_ghosts_do_not_depend_on_their_batch():
    scenario = load(LANE_CHANGE, (GHOSTS, ASSOCIATE, "steps=20"))
    problem = scenario.problem(scenario.specifications[0])
    tapes = np.random.default_rng(0).standard_normal((7, 21, problem.noise_size))
    source = NoiseSource(0, problem.noise_size)
    whole = problem.simulate(source, Request.replay(tapes))
    for part in (slice(0, 1), slice(2, 6)):
        alone = problem.simulate(source, Request.replay(tapes[part]))
        assert alone.robustness.tobytes() == whole.robustness[part].tobytes()
