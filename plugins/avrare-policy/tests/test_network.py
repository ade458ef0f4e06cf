"""The network: its file, its arithmetic, its rows."""

from itertools import pairwise

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_policy.network import Network, load, save


def network(sizes=(7, 16, 16, 2), activation="tanh", seed=0):
    rng = np.random.default_rng(seed)
    shapes = list(pairwise(sizes))
    return Network(
        weights=tuple(rng.normal(size=shape).astype(np.float32) for shape in shapes),
        biases=tuple(rng.normal(size=shape[1]).astype(np.float32) for shape in shapes),
        activation=activation,
        mean=rng.normal(size=sizes[0]),
        scale=rng.uniform(0.5, 2.0, sizes[0]),
        low=np.full(sizes[-1], -1.0),
        high=np.array([0.5, 1.0])[: sizes[-1]],
        provenance={"license": "BSD-3-Clause"},
    )


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_the_arithmetic(activation):
    net = network(activation=activation)
    x = np.random.default_rng(1).normal(size=(5, 7))
    values = (x - net.mean) / net.scale
    function = np.tanh if activation == "tanh" else lambda v: np.maximum(v, 0.0)
    for k in range(3):
        values = values @ net.weights[k].astype(float) + net.biases[k]
        values = function(values) if k < 2 else values
    np.testing.assert_allclose(net(x), np.clip(values, net.low, net.high), rtol=2e-4, atol=2e-4)
    assert net(100.0 * x)[:, 0].max() <= 0.5


def test_a_saved_network_is_loaded(tmp_path):
    net, path = network(), tmp_path / "net.npz"
    save(path, net)
    again = load(path)
    x = np.random.default_rng(1).normal(size=(9, 7))
    assert np.array_equal(net(x), again(x))
    assert again.provenance == net.provenance
    first = path.read_bytes()
    save(path, again)
    assert path.read_bytes() == first


def broken(arrays, name):
    arrays = dict(arrays)
    match name:
        case "no bias":
            del arrays["b1"]
        case "shape":
            arrays["W1"] = arrays["W1"][:-1]
        case "not finite":
            arrays["W0"] = np.where(arrays["W0"] > 1.0, np.nan, arrays["W0"])
        case "activation":
            arrays["activation"] = np.array("sigmoid")
        case "scale":
            arrays["scale"] = np.zeros(7)
        case "range":
            arrays["low"] = np.zeros(3)
        case "format":
            arrays["format"] = np.array(99)
        case "text":
            arrays["W0"] = np.full((7, 16), "x")
        case "no layers":
            arrays = {key: value for key, value in arrays.items() if key[0] not in "Wb"}
    return arrays


NAMES = ["no bias", "shape", "not finite", "activation", "scale", "range", "format", "text", "no layers"]


@pytest.mark.parametrize("name", NAMES)
def test_an_invalid_file_is_refused(tmp_path, name):
    path = tmp_path / "net.npz"
    save(path, network())
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    np.savez(path, **broken(arrays, name))
    with pytest.raises(UsageError, match=r"net\.npz"):
        load(path)


def test_pickles_are_refused(tmp_path):
    path = tmp_path / "net.npz"
    save(path, network())
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays["W0"] = np.array([{"a": 1}], dtype=object)
    np.savez(path, **arrays)
    with pytest.raises(UsageError, match="not a policy"):
        load(path)
