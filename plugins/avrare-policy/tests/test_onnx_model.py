"""ONNX policies: written here byte by byte, so that no further package is needed."""

import struct

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_policy.config import PolicyConfig
from avrare_policy.controller import build


def varint(value):
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def field(number, value):
    """Encode a field of a protocol buffer: integers as varint, everything else with its length."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(name, values):
    values = np.asarray(values, dtype="<f4")
    dims = b"".join(field(1, size) for size in values.shape)
    return dims + field(2, 1) + field(8, name) + field(9, values.tobytes())


def value(name, *dims, kind=1):
    axes = b"".join(field(1, field(2, dim) if isinstance(dim, str) else field(1, dim)) for dim in dims)
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, axes)))


def node(operation, inputs, output):
    return b"".join(field(1, name) for name in inputs) + field(2, output) + field(4, operation)


def model(nodes, tensors, inputs, output):
    graph = b"".join(field(1, one) for one in nodes) + field(2, "policy")
    graph += b"".join(field(5, one) for one in tensors)
    graph += b"".join(field(11, one) for one in inputs) + field(12, output)
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17))


WEIGHTS = np.random.default_rng(1).standard_normal((4, 33)), np.random.default_rng(2).standard_normal((33, 2))


def network(rows="batch"):
    nodes = [node("MatMul", ["seen", "W0"], "a"), node("Tanh", ["a"], "b")]
    nodes.append(node("MatMul", ["b", "W1"], "action"))
    tensors = [tensor(f"W{k}", weight) for k, weight in enumerate(WEIGHTS)]
    return model(nodes, tensors, [value("seen", rows, 4)], value("action", rows, 2))


def single(operation, dims, inputs="a", kind=1):
    named = [value(name, *dims, kind=kind) for name in inputs]
    return model([node(operation, inputs, "c")], [], named, value("c", *dims, kind=kind))


def controller(tmp_path, content, **options):
    path = tmp_path / "policy.onnx"
    path.write_bytes(content)
    return build(PolicyConfig(model=str(path), **options))


@pytest.mark.parametrize("rows", ["batch", 1])
def test_the_first_output_is_the_action_whatever_the_batch(tmp_path, rows):
    policy = controller(tmp_path, network(rows))
    seen = np.random.default_rng(3).standard_normal((50, 4))
    action, _ = policy.act(None, seen, None)
    np.testing.assert_allclose(action, np.tanh(seen @ WEIGHTS[0]) @ WEIGHTS[1], rtol=2e-5, atol=2e-6)
    parts = [policy.act(None, seen[a:b], None)[0] for a, b in ((0, 1), (1, 18), (18, 50))]
    np.testing.assert_array_equal(np.concatenate(parts), action)


def test_argmax_gives_the_number_of_the_largest_output(tmp_path):
    policy = controller(tmp_path, network(), output="argmax")
    seen = np.random.default_rng(3).standard_normal((9, 4))
    wanted = (np.tanh(seen @ WEIGHTS[0]) @ WEIGHTS[1]).argmax(axis=1)
    assert policy.act(None, seen, None)[0][:, 0].tolist() == wanted.tolist()


def test_an_observation_of_another_size(tmp_path):
    with pytest.raises(UsageError, match="observations of 4 numbers, the simulator gives 3"):
        controller(tmp_path, network()).act(None, np.zeros((2, 3)), None)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no model", "not an ONNX model"),
        (network()[:200], "not an ONNX model"),
        (single("Add", [1, 2], "ab"), r"2 inputs \(a, b\)"),
        (single("Tanh", [7]), "not floats"),
        (single("Neg", ["n", 2], kind=7), "not floats"),
    ],
)
def test_a_file_that_is_no_policy_is_refused(tmp_path, content, message):
    with pytest.raises(UsageError, match=message):
        controller(tmp_path, content)


def test_the_encoder_of_this_test_writes_floats_as_they_are():
    assert struct.pack("<f", 1.5) in tensor("x", [1.5])
