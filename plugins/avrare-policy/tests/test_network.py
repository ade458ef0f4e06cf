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


BREAKS = {
    "no bias": lambda kept: kept.pop("b1"),
    "shape": lambda kept: kept.update(W1=kept["W1"][:-1]),
    "not finite": lambda kept: kept.update(W0=np.where(kept["W0"] > 1.0, np.nan, kept["W0"])),
    "activation": lambda kept: kept.update(activation=np.array("sigmoid")),
    "scale": lambda kept: kept.update(scale=np.zeros(7)),
    "range": lambda kept: kept.update(low=np.zeros(3)),
    "format": lambda kept: kept.update(format=np.array(99)),
    "text": lambda kept: kept.update(W0=np.full((7, 16), "x")),
    "no layers": lambda kept: [kept.pop(key) for key in list(kept) if key[0] in "Wb"],
    "not a policy": lambda kept: kept.update(W0=np.array([{"a": 1}], dtype=object)),
}


@pytest.mark.parametrize("name", BREAKS)
def test_an_invalid_file_is_refused(tmp_path, name):
    path = tmp_path / "net.npz"
    save(path, network())
    with np.load(path) as file:
        arrays = dict(file)
    BREAKS[name](arrays)
    np.savez(path, **arrays)
    with pytest.raises(UsageError, match=r"net\.npz" if name != "not a policy" else name):
        load(path)
