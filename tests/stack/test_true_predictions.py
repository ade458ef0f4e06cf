import numpy as np

from avrare.driving import Action
from avrare.stack.closed_loop import ClosedLoop
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build


class Watcher:
    """Controller without a base class that keeps the last prediction."""

    horizon = 2

    def __init__(self, sees_truth):
        self.sees_truth = sees_truth

    def start(self, n):
        return None

    def act(self, memory, ego, prediction):
        self.seen = prediction
        zeros = np.zeros_like(ego.x)
        return Action(zeros, zeros), None


def loop_of(watcher):
    vehicle = {"name": "car", "x": 50.0, "y": 1.75, "speed": 10.0}
    options = {"dt": 0.2, "ego": {"x": 0.0, "y": 1.75, "speed": 20.0}, "vehicles": [vehicle]}
    return ClosedLoop(build(SingleTrackConfig.model_validate(options)), controller=watcher)


def test_a_controller_that_sees_the_truth_needs_no_tracker():
    watcher = Watcher(sees_truth=True)
    loop = loop_of(watcher)
    noise = np.zeros((3, loop.noise_size))
    state = loop.step(loop.initial(noise), noise)
    loop.step(state, noise)
    np.testing.assert_allclose(watcher.seen.x[:, 0], np.tile([52.0, 54.0, 56.0], (3, 1)))
    np.testing.assert_allclose(watcher.seen.y, 1.75)


def test_another_controller_gets_what_the_tracker_says():
    watcher = Watcher(sees_truth=False)
    loop = loop_of(watcher)
    noise = np.zeros((3, loop.noise_size))
    loop.step(loop.initial(noise), noise)
    assert watcher.seen is None
