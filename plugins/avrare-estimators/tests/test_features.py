"""Features of a closed loop: what its parts declare, or what every driving stack has."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.base import batch
from avrare.driving import Prediction, Vehicles, World
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.stack.features import track_features

ROWS, STEPS = 5, 3
LANE_CHANGE = Path(__file__).parents[3] / "scenarios" / "lane_change_published.yaml"


@pytest.fixture(scope="module")
def problem():
    settings = ["controller.backend=riccati", "controller.search=follow"]
    return avrare.load(LANE_CHANGE, settings).problem("no_collision")


@pytest.fixture(scope="module")
def outcome(problem):
    request = Request.from_start(np.zeros(ROWS, np.int64), np.arange(ROWS), keep_carries=True)
    request = replace(request, until=STEPS, observe=(1, STEPS))
    return problem.simulate(NoiseSource(1, problem.noise_size), request)


def test_a_driving_stack_offers_signals_positions_errors_and_plan(problem, outcome):
    ((t, _, carry),) = outcome.carries
    assert t == STEPS
    system, state = problem.system, carry.system
    found = system.features(state)
    assert np.isfinite(found).all()
    assert np.array_equal(outcome.features[:, 1, :-3], found)
    # The error of a believed position is among them, and a node of the plan relative to its first.
    errors = system.tracker.predict(state.track, 1).x[..., 0] - state.world.others.x
    assert np.ptp(errors, axis=0).any()
    plan = state.memory.plan_states
    relative = state.world.others.x - state.world.ego.x[:, None]
    for column in (*errors.T, plan[:, 10, 0] - plan[:, 0, 0], state.world.ego.speed, *relative.T):
        assert any(np.array_equal(column, other) for other in found.T)
    part = system.features(batch.take(state, np.array([3, 1])))
    assert np.array_equal(part, found[[3, 1]])


def test_a_vehicle_without_a_track_has_no_error_and_no_warning():
    def vehicles(shape):
        return Vehicles(*np.ones((5, *shape)))

    class Blind:
        def predict(self, track, steps):
            nowhere = np.full((ROWS, 2, steps + 1), np.inf)
            nowhere[:, 0] = 3.0
            return Prediction(nowhere, nowhere)

    world = World(np.zeros(ROWS, np.int64), vehicles((ROWS,)), vehicles((ROWS, 2)), np.zeros(ROWS))
    found = track_features(Blind(), None, world)
    assert found.tolist() == [[1, 0, 2, 0, 2, 0, 0, 0, 0, 0]] * ROWS


def test_declared_features_take_the_place_of_the_general_ones(problem, outcome, monkeypatch):
    ((*_, carry),) = outcome.carries
    system = problem.system
    for part, value, width in (
        (system.simulator, 5.0, 3),
        (system.tracker, 7.0, 2),
        (system.controller, 9.0, 1),
    ):
        declared = np.full((ROWS, width), value)
        monkeypatch.setattr(part, "features", lambda state, declared=declared: declared, raising=False)
    found = system.features(carry.system)
    assert np.array_equal(found, np.tile([5.0, 5.0, 5.0, 7.0, 7.0, 9.0], (ROWS, 1)))
