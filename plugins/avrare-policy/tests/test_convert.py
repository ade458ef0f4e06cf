"""Conversion of torch and stable-baselines3 policies."""

import argparse
import io
import zipfile

import numpy as np
import pytest
import torch

from avrare.base.errors import UsageError
from avrare_policy import command
from avrare_policy.convert import convert
from avrare_policy.network import load


def chain(activation=torch.nn.Tanh):
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(3, 8), activation(), torch.nn.Linear(8, 2))


def archive(path, **layers):
    """Write a stable-baselines3 archive: ``policy.pth`` beside files that nobody needs to read."""
    weights = {
        f"{name}.{part}": value
        for name, layer in layers.items()
        for part, value in torch.nn.Sequential(*layer).state_dict().items()
    }
    weights |= {"value_net.weight": torch.zeros(1, 8), "log_std": torch.zeros(2)}
    content = io.BytesIO()
    torch.save({name.replace("action_net.0", "action_net"): x for name, x in weights.items()}, content)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("data", "{}")
        file.writestr("policy.pth", content.getvalue())
    return path


def run(*words):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.execute(parser.parse_args(list(map(str, words))))


@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_a_torch_network_acts_as_before(tmp_path, activation):
    network = chain({"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[activation])
    torch.save(network.state_dict(), tmp_path / "policy.pt")
    words = ["--activation", activation, "--low", -0.4, "--high", 0.4]
    assert run("convert", tmp_path / "policy.pt", "--out", tmp_path, *words) == 0
    seen = np.random.default_rng(1).standard_normal((20, 3))
    wanted = network(torch.tensor(seen, dtype=torch.float32)).detach().numpy().clip(-0.4, 0.4)
    np.testing.assert_allclose(load(tmp_path / "policy.npz")(seen), wanted, rtol=1e-5, atol=1e-6)


def test_ppo_is_recognised(tmp_path):
    body, head = [torch.nn.Linear(3, 8), torch.nn.Tanh()], [torch.nn.Linear(8, 2)]
    path = archive(tmp_path / "ppo.zip", **{"mlp_extractor.policy_net": body, "action_net": head})
    network, layout = convert(path)
    assert layout.name == "PPO or A2C of stable-baselines3"
    assert (network.activation, network.squash) == ("tanh", False)
    seen = np.random.default_rng(1).standard_normal((20, 3))
    wanted = torch.nn.Sequential(*body, *head)(torch.tensor(seen, dtype=torch.float32)).detach().numpy()
    np.testing.assert_allclose(network(seen), wanted, rtol=1e-5, atol=1e-6)


def test_td3_squashes_into_the_range_of_the_action(tmp_path):
    body = [torch.nn.Linear(3, 8), torch.nn.ReLU(), torch.nn.Linear(8, 2)]
    path = archive(tmp_path / "td3.zip", **{"actor.mu": body})
    assert run("convert", path, "--out", tmp_path, "--low", 0, "--high", 5) == 0
    seen = np.random.default_rng(1).standard_normal((20, 3))
    raw = torch.nn.Sequential(*body)(torch.tensor(seen, dtype=torch.float32)).detach().numpy()
    np.testing.assert_allclose(load(tmp_path / "td3.npz")(seen), 2.5 * (np.tanh(raw) + 1.0), rtol=1e-5)


def test_code_in_a_pickle_does_not_run(tmp_path):
    class Attack:
        def __reduce__(self):
            return (tmp_path / "owned").touch, ()

    torch.save({"weight": Attack()}, tmp_path / "policy.pt")
    with pytest.raises(UsageError, match="cannot be read as tensors"):
        convert(tmp_path / "policy.pt")
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {"a.weight": torch.zeros(2, 3), "b.weight": torch.zeros(2, 5)},
            "do not form a chain: 3 -> 2, 5 -> 2",
        ),
        ({"bias": torch.zeros(3)}, "no linear layers"),
        (torch.zeros(3), "no state dict"),
    ],
)
def test_what_is_no_chain_of_layers_is_refused(tmp_path, content, message):
    torch.save(content, tmp_path / "policy.pt")
    with pytest.raises(UsageError, match=message):
        convert(tmp_path / "policy.pt")
