"""The controller: what it takes, which policy it finds."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import ObservingEgo
from avrare_policy.config import PolicyConfig
from avrare_policy.controller import PolicyController, build, locate
from avrare_policy.network import Network, save


def small():
    return Network(
        (np.eye(2, dtype=np.float32),), (np.zeros(2, dtype=np.float32),), "tanh",
        np.zeros(2), np.ones(2), np.full(2, -1.0), np.full(2, 1.0), {},
    )  # fmt: skip


def test_the_policy_acts_on_the_observation_of_the_ego_or_on_the_ego_itself():
    controller = PolicyController(small())
    seen = np.array([[0.25, -3.0], [0.5, 0.0]])
    wanted = np.array([[0.25, -1.0], [0.5, 0.0]])
    for ego in (ObservingEgo(*np.zeros((5, 2)), seen), seen):
        action, memory = controller.act(controller.start(2), ego, None)
        assert np.array_equal(action, wanted)
        assert memory is None


def test_an_observation_of_another_size():
    with pytest.raises(UsageError, match="observations of 2 numbers, the simulator gives 3"):
        PolicyController(small()).act(None, np.zeros((4, 3)), None)


def test_a_policy_from_a_path(tmp_path):
    path = tmp_path / "mine.npz"
    save(path, small())
    controller = build(PolicyConfig(model=str(path)))
    assert np.array_equal(controller.network(np.full((1, 2), 0.5)), [[0.5, 0.5]])


def test_unknown_policies(tmp_path):
    with pytest.raises(UsageError, match="no such file"):
        locate(str(tmp_path / "none.npz"))
    with pytest.raises(UsageError, match="unknown policy 'merge_lidra'"):
        locate("merge_lidra")
