"""The tracker on filterpy against ``imm``."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Observation
from avrare.testing.conformance import sample_traffic
from avrare_imm import filterpy_tracker
from avrare_imm.config import ImmConfig
from avrare_imm.tracker import ImmTracker

N = 3


def observations(steps, missed=0.0):
    rng = np.random.default_rng(4)
    for step in range(1, steps + 1):
        others = sample_traffic.world(rng.standard_normal((N, 4)), step).others
        seen = rng.random(others.x.shape) >= missed
        fields = (others.x, others.y, others.speed)
        x, y, speed = (np.where(seen, v + rng.normal(0, 0.4, v.shape), np.nan) for v in fields)
        yield Observation(seen, x, y, speed)


def both(**options):
    config, scene = ImmConfig(**options), sample_traffic.scene()
    world = sample_traffic.world(np.zeros((N, 4)), 0)
    trackers = ImmTracker(config, scene), filterpy_tracker.FilterpyTracker(config, scene)
    return trackers, [tracker.start(world) for tracker in trackers]


def compare(ours, theirs, track, other):
    for name, value in vars(ours.estimate(track)).items():
        np.testing.assert_allclose(vars(theirs.estimate(other))[name], value, rtol=0, atol=1e-9, err_msg=name)
    for mine, its in zip(
        vars(ours.predict(track, 5)).values(), vars(theirs.predict(other, 5)).values(), strict=True
    ):
        np.testing.assert_allclose(its, mine, rtol=0, atol=1e-8)


@pytest.mark.parametrize("missed", [0.0, 0.4])
def test_it_agrees_with_imm_on_detections_and_on_misses(missed):
    (ours, theirs), (track, other) = both()
    for observation in observations(12, missed):
        track, other = ours.update(track, observation), theirs.update(other, observation)
        compare(ours, theirs, track, other)


def test_gate_and_track_life_are_those_of_imm():
    (ours, theirs), (track, other) = both(gate=3.0, start="empty", death=2)
    for observation in observations(12, 0.3):
        track, other = ours.update(track, observation), theirs.update(other, observation)
        np.testing.assert_array_equal(track.life.exists, other.life.exists)
        compare(ours, theirs, track, other)


def test_a_single_model_is_refused():
    with pytest.raises(UsageError, match="at least two longitudinal models"):
        filterpy_tracker.build(ImmConfig(longitudinal_models=("cv",)), sample_traffic.scene())
    with pytest.raises(UsageError, match="'filterpy' needs a driving simulator"):
        filterpy_tracker.build(ImmConfig(), None)
