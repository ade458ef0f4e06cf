"""The controller: what it takes, which policy it finds, and arrays in place of those of the file."""

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


@pytest.fixture
def path(tmp_path):
    weights = (np.ones((2, 3), np.float32), np.ones((3, 1), np.float32))
    biases = (np.zeros(3, np.float32), np.zeros(1, np.float32))
    low, high = np.array([-9.0]), np.array([9.0])
    network = Network(weights, biases, "relu", np.zeros(2), np.ones(2), low, high, {})
    save(tmp_path / "small.npz", network)
    return tmp_path / "small.npz"


def act(path, **arrays):
    controller = build(PolicyConfig(model=str(path), arrays=arrays or None))
    return controller, controller.act(None, np.array([[1.0, 0.5]]), None)[0].item()


def test_arrays_replace_those_of_the_file(path):
    assert act(path)[1] == 4.5
    controller, action = act(path, b1=[0.25], W1=[[1.0], [0.0], [0.0]])
    assert action == 1.75
    assert controller.arrays["W1"].tolist() == [[1.0], [0.0], [0.0]]
    assert controller.arrays["W0"].tolist() == np.ones((2, 3)).tolist()
    assert sorted(controller.arrays) == ["W0", "W1", "b0", "b1"]


@pytest.mark.parametrize(
    ("arrays", "text"),
    [
        ({"b2": [1.0]}, "has no array 'b2'"),
        ({"b1": [1.0, 2.0]}, r"b1 needs numbers of shape \(1,\), not \(2,\)"),
        ({"b1": ["much"]}, r"b1 needs numbers of shape \(1,\)"),
        ({"b1": [float("nan")]}, "finite"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(path, arrays, text):
    with pytest.raises(UsageError, match=text):
        act(path, **arrays)


def test_a_gain_multiplies_the_outputs_before_they_are_clipped(path):
    def act(gain):
        controller = build(PolicyConfig(model=str(path), gain=gain))
        return controller.act(None, np.array([[0.1, 0.05], [1.0, 1.0]]), None)[0]

    plain, doubled = act(None), act((2.0,))
    assert plain.tolist() == act((1.0,)).tolist()
    assert abs(plain[0, 0]) > 0.0
    np.testing.assert_allclose(doubled, np.clip(2.0 * plain, -9.0, 9.0), rtol=1e-6)
    assert doubled[1, 0] == 9.0
    with pytest.raises(UsageError, match="gain needs 1 numbers, not 2"):
        act((1.0, 1.0))
    for gain in (1e300, -1e39):
        with pytest.raises(UsageError, match="gain needs finite numbers"):
            act((gain,))


def test_a_gain_multiplies_biases_too(path):
    def act(**options):
        controller = build(PolicyConfig(model=str(path), **options))
        return controller.act(None, np.array([[0.1, 0.0]]), None)[0].item()

    bias = {"b1": [0.5]}
    assert act(arrays=bias) == pytest.approx(0.8)
    assert act(arrays=bias, gain=(3.0,)) == pytest.approx(2.4)
