"""Stacks with false detections: what they need, and that their rollouts keep the promises of all rollouts."""

from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.cli.main import main
from avrare.driving import Scene
from avrare.rollout.loaded_scenario import load
from avrare.testing.faulty_systems import Mortal
from estimates import estimate_through_kills, plain

LANE_CHANGE = str(Path(__file__).parents[2] / "scenarios" / "lane_change.yaml")
GHOSTS = "perception.ghosts={rate: 0.5, persistence: 0.4, forward: [5, 40]}"
ASSOCIATE = "tracker.association=hungarian"

BRAKE = """\
import numpy as np


def act(o):
    near = [np.where((abs(c.y - o.ego.y) < 2) & (c.x > o.ego.x), c.x, np.inf) for c in o.others.values()]
    return np.clip(np.min(near, axis=0) - o.ego.x - 35, -6, 1), 0 * o.ego.x
"""
"""Brakes for whatever the tracker knows ahead, ghosts as well; cheap beside the scenario's planner."""


@pytest.fixture
def problem(tmp_path):
    """Return a function that builds a problem; with ``lives`` its system is killed after so many steps."""
    (tmp_path / "brake.py").write_text(BRAKE)
    cheap = f"controller={{plugin: function, file: {tmp_path / 'brake.py'}, batched: true}}"
    perception = GHOSTS.replace("perception.ghosts=", "perception={plugin: parametric, ghosts: ") + "}"

    def build(lives):
        loaded = load(LANE_CHANGE, (perception, ASSOCIATE, cheap, "steps=22", "chunk=8"))
        built = loaded.problem("no_abrupt_braking")
        built.system = Mortal(built.system, lives)
        return built

    return build


def estimate(problem, **options):
    return plain(avrare.estimate(problem, "ams", seed=3, particles=8, discard=2, runs=2, **options))


@pytest.mark.slow
def test_splitting_with_ghosts_that_is_killed_goes_on_to_the_same_bits(problem, tmp_path):
    found, kills = estimate_through_kills(
        lambda kills: estimate(problem(120 + 40 * kills), checkpoint=tmp_path / "kept")
    )
    assert kills > 1
    assert found == estimate(problem(np.inf))


def test_a_tracker_that_is_told_the_vehicle_is_refused(capsys):
    assert main(["validate", "--build", LANE_CHANGE, "--set", GHOSTS]) == 4
    error = capsys.readouterr().err
    assert "tracker: it needs to know the vehicle of each detection" in error
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
    assert loop.noise_size == 22 + 3 * 5
