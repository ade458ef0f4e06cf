"""Burn-in: tracks at t = 0 that come from detections before it."""

from pathlib import Path

import numpy as np
import pytest

from avrare.base import batch
from avrare.driving import Vehicles
from avrare.protocols import PerceptionErrorModel
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.weighted_problem import log_ratios
from avrare.scenario.load import load
from avrare.stack.burn_in import BurnIn, rewind
from avrare.stack.closed_loop import SamplingLaw, WeightedLoop

SCENARIO = Path(__file__).parents[2] / "scenarios" / "lane_change_published.yaml"
BURNING = ("tracker.start=burn_in", "tracker.burn_in=2.0")
PARAMETRIC = ("perception={plugin: parametric}", *BURNING)


def loop_of(*settings):
    return LoadedScenario(load(str(SCENARIO), ("controller.backend=riccati", *settings))).stack.loop


def first_row(loop, n, seed=0):
    return np.random.default_rng(seed).standard_normal((n, loop.noise_size))


def test_vehicles_come_from_where_their_velocity_points_back():
    values = (np.array([part]) for part in (100.0, 3.0, np.pi / 6, 20.0, 2.0))
    before = rewind(Vehicles(*values), 0.5)
    assert before.x == pytest.approx(100.0 - 10.0 * np.cos(np.pi / 6))
    assert before.y == pytest.approx(3.0 - 5.0)
    assert before.speed == 20.0
    assert before.acceleration == 0.0


def test_the_last_world_of_a_burn_in_is_the_start_and_the_first_is_a_step_after_its_begin():
    loop = loop_of(*BURNING)
    noise = first_row(loop, 2)
    world = loop.initial(noise).world
    worlds = [before for before, _ in loop.burn_in.worlds(world, noise)]
    assert len(worlds) == 20
    np.testing.assert_array_equal(worlds[-1].ego.x, world.ego.x)
    np.testing.assert_allclose(worlds[0].ego.x, world.ego.x - 1.9 * 21.6)
    np.testing.assert_array_equal(worlds[0].others.x[:, 0], world.others.x[:, 0])  # it is parked


def test_tracks_come_from_detections_and_those_that_the_detector_misses_do_not_exist():
    near = loop_of(*PARAMETRIC, "simulator.ego.x=5.0")
    far = loop_of(*PARAMETRIC, "simulator.ego.x=-90.0")
    for loop, least, most in ((near, 0.9, 1.0), (far, 0.0, 0.05)):
        state = loop.initial(first_row(loop, 200))
        now = loop.tracker.estimate(state.track)
        share = now.exists[:, 0].mean()
        assert least <= share <= most
        error = (now.x - state.world.others.x)[:, 0][now.exists[:, 0]]
        if loop is near:
            assert 0.02 < np.median(np.abs(error)) < 0.5


def test_perfect_noise_sees_the_truth_all_the_time():
    loop = loop_of(*PARAMETRIC, "simulator.ego.x=5.0")
    state = loop.initial(loop.perfect_noise[None])
    now = loop.tracker.estimate(state.track)
    in_sight = [0, 2]  # the second one is behind the first
    assert now.exists[0].tolist() == [True, False, True]
    np.testing.assert_allclose(now.x[:, in_sight], state.world.others.x[:, in_sight], atol=0.01)


def test_the_numbers_of_a_channel_are_standard_normal_and_its_own():
    class Model(PerceptionErrorModel):
        noise_size = 2

        def observe(self, world, noise):
            raise NotImplementedError

    burn_in = BurnIn(None, Model(), 20, 0.1)
    first = np.random.default_rng(1).standard_normal((20_000, 2))
    numbers = np.array([burn_in._noise(first, step) for step in range(20)])
    assert np.abs(numbers.mean(axis=1)).max() < 0.035
    assert np.abs(numbers.std(axis=1) - 1.0).max() < 0.025
    together = np.concatenate([first.T, numbers.reshape(-1, 20_000, 2).transpose(0, 2, 1).reshape(40, -1)])
    assert np.abs(np.corrcoef(together) - np.eye(42)).max() < 0.04
    other = first.copy()
    other[:, 0] += 1e-9
    moved = burn_in._noise(other, 3)
    np.testing.assert_array_equal(moved[:, 1], numbers[3][:, 1])
    assert np.abs(moved[:, 0] - numbers[3][:, 0]).min() > 0.0
    np.testing.assert_array_equal(burn_in._noise(np.zeros((1, 2)), 7), 0.0)


def test_a_proposal_starts_from_the_burn_in_of_the_target():
    loop = loop_of(*PARAMETRIC)
    proposal = loop_of("perception={plugin: naive}").perception
    noise = first_row(loop, 20)
    weighted = WeightedLoop(loop, proposal, SamplingLaw())
    start = weighted.initial(noise)
    assert not start.log_weight.any()
    tracks = (batch.leaves(track) for track in (start.loop.track, loop.initial(noise).track))
    for one, other in zip(*tracks, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("persistence", ["{}", "{detection: 0.5, position: 0.5, detection_lasting: 0.2}"])
def test_the_density_ratio_of_another_model_counts_the_burn_in(persistence):
    settings = (*BURNING, "simulator.ego.x=-20.0", "tracker.burn_in=0.5", "steps=1")
    model = "perception={{plugin: parametric, persistence: {}, detection_range: {}}}"
    blocks = (model.format(persistence, far) for far in (54, 56))
    loaded, other = (LoadedScenario(load(str(SCENARIO), (block, *settings))) for block in blocks)
    problem = loaded.problem(("no_collision",))
    rng = np.random.default_rng(5)
    tapes = rng.standard_normal((4000, 2, problem.noise_size))
    weight = np.exp(log_ratios(problem, [other.stack.loop.perception], tapes)[:, 0])
    loops = (problem.system, other.stack.loop)
    exists = [loop.tracker.estimate(loop.initial(tapes[:, 0]).track).exists[:, 0] for loop in loops]
    spread = np.std(weight * exists[0]) / np.sqrt(len(tapes)) + 0.5 / np.sqrt(len(tapes))
    assert exists[1].mean() > exists[0].mean() + 2.0 * spread / 3.0
    assert np.mean(weight * exists[0]) == pytest.approx(exists[1].mean(), abs=3.0 * spread)
    assert weight.mean() == pytest.approx(1.0, abs=4.0 * np.std(weight) / np.sqrt(len(tapes)))
