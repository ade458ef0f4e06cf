"""Impact: it ends a drive, is seen between two samples, and no later sample counts."""

from dataclasses import replace

import numpy as np
import pytest

from avrare import Problem, stl
from avrare.driving import Action
from avrare.rollout.noise import NoiseSource
from avrare.rollout.replay import replay_tape
from avrare.rollout.request import Request
from avrare.stack.closed_loop import ClosedLoop
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build

STEPS = 20


def loop(distance=30.0, speed=20.0, **options):
    parked = {"name": "parked", "x": distance, "y": 1.75, "speed": 0.0, "heading": np.pi}
    oncoming = {**parked, "speed": options.pop("oncoming", 0.0)}
    size = options.pop("length", 4.298)
    ego = {"x": 0.0, "y": 1.75, "speed": speed, "length": size, "wheelbase": 0.5 * size}
    config = SingleTrackConfig(ego=ego, vehicles=[{**oncoming, "length": size}], **options)
    return ClosedLoop(build(config), controller=Coasts())


class Coasts:
    horizon = 0

    def start(self, n):
        return np.zeros(n)

    def act(self, memory, ego, prediction):
        return Action(np.zeros(len(ego.x)), np.zeros(len(ego.x))), memory


def judge(system, formula):
    problem = Problem(system, stl(formula), STEPS)
    tape = np.zeros((1, STEPS + 1, problem.noise_size))
    return problem.replay(tape), replay_tape(problem, tape[0])


def test_no_sample_after_an_impact_counts():
    impact = int((30.0 - 4.298) / 2.0) + 1  # 2 m in a step
    for formula, violated in ((f"always (ego_x < {2 * impact + 0.5})", False), ("always (gap > 0)", True)):
        outcome, rollout = judge(loop(), formula)
        assert outcome.violated[0, 0] == rollout.violated == violated
        assert len(rollout.states) == impact + 1
        assert rollout.signals["gap"][-1] <= 0.0 < rollout.signals["gap"][-2]
    outcome, rollout = judge(loop(after_impact="go_on"), f"always (ego_x < {2 * impact + 0.5})")
    assert outcome.violated[0, 0]
    assert len(rollout.states) == STEPS + 1


def test_windows_end_with_the_drive():
    formula = "always (gap > 0 or eventually[1:3 samples] (ego_x > 30))"
    assert judge(loop(), formula)[0].violated[0, 0]
    assert not judge(loop(after_impact="go_on"), formula)[0].violated[0, 0]


@pytest.mark.parametrize("early", [False, True])
def test_an_ended_rollout_keeps_verdict_and_robustness(early):
    problem = Problem(loop(), stl("always (gap > 0)"), STEPS)
    request = replace(Request.from_start(np.zeros(3, np.int64), np.arange(3)), stop_early=early)
    outcome = problem.simulate(NoiseSource(0, problem.noise_size), request)
    assert outcome.violated.all()
    whole = judge(loop(), "always (gap > 0)")[1]
    np.testing.assert_array_equal(outcome.robustness[:, 0], whole.signals["gap"].min())


def test_two_cars_head_on_cannot_pass_through_each_other():
    system = loop(distance=75.9, speed=40.0, oncoming=40.0, length=3.5)
    outcome, rollout = judge(system, "always (gap > 0)")
    assert outcome.violated[0, 0]
    last = rollout.states[-1].world
    assert last.ended[0]
    assert -0.03 < rollout.signals["gap"][-1] <= 0.0
    assert last.others.x[0, 0] - last.ego.x[0] == pytest.approx(3.5, abs=0.03)
    unseen = loop(distance=75.9, speed=40.0, oncoming=40.0, length=3.5, after_impact="go_on")
    assert not judge(unseen, "always (gap > 0)")[0].violated[0, 0]
