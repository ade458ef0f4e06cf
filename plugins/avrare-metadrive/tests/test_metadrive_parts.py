"""Parts that need no MetaDrive: options, the guard, the noise, the network."""

import subprocess
import sys

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.special import ndtr
from scipy.stats import truncnorm

import avrare_metadrive
from avrare.base.errors import PluginError
from avrare.plugin.first_party import pip_line
from avrare.plugin.registry import Registry
from avrare_metadrive import expert, version, world
from avrare_metadrive.config import ExpertConfig, MetaDriveConfig
from avrare_metadrive.world import disturb

SD = np.sqrt(0.004)


@pytest.mark.parametrize(
    "wrong",
    [{"map": "3"}, {"map": ""}, {"noise": {"variance": -1}}, {"noise": 0.1}, {"copy": "no"}, {"seed": 1}],
)
def test_options_that_are_refused(wrong):
    with pytest.raises(ValidationError):
        MetaDriveConfig.model_validate(wrong)


def test_describing_and_validating_import_nothing_heavy():
    code = (
        "import sys, avrare_metadrive, avrare_metadrive.config; avrare_metadrive.avrare_components()\n"
        "print([name for name in ('metadrive', 'panda3d', 'scipy', 'gymnasium') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_another_version_is_a_row_with_the_reason(monkeypatch):
    monkeypatch.setattr(version, "find_version", lambda: "0.4.2")
    registry = Registry()
    registry.register(avrare_metadrive, "metadrive", "avrare-metadrive", "0.1.0")
    (row,) = [row for row in registry.rows() if row.distribution == "avrare-metadrive"]
    assert row.status == "broken"
    assert "metadrive-simulator 0.4.2 is installed, but 0.4.3 is required" in row.detail
    assert "\n" not in row.detail
    with pytest.raises(PluginError, match=r"0\.4\.2"):
        registry.require("simulator", "metadrive")


def test_without_metadrive_there_is_a_row_and_no_simulator(monkeypatch):
    monkeypatch.setattr(version, "find_version", lambda: None)
    needs = [part.needs for part in avrare_metadrive.avrare_components()]
    assert needs == [("metadrive", "scipy"), ("metadrive",)]
    for build, config in ((world.build, MetaDriveConfig()), (expert.build, ExpertConfig())):
        with pytest.raises(PluginError, match="is not installed") as caught:
            build(config)
        assert "metadrive-simulator==0.4.3" in caught.value.hint
    assert pip_line("metadrive") == "pip install metadrive-simulator==0.4.3"  # `metadrive` is somebody else's


@pytest.mark.parametrize("distance", [0.0, 0.03, 0.5, 0.97, 1.0])
def test_noise_follows_the_truncated_normal_law(distance):
    normals = np.linspace(-4.0, 4.0, 81)
    ends = (0.0 - distance) / SD, (1.0 - distance) / SD
    expected = truncnorm.ppf(ndtr(normals), *ends, loc=distance, scale=SD)
    found = disturb(np.full(81, distance), normals, SD)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert (np.diff(found) > 0.0).all()


def test_noise_stays_within_what_a_ray_can_read_and_keeps_its_tails():
    far = disturb(np.array([0.5, 0.5, 1.0, 0.0]), np.array([-12.0, 12.0, -12.0, 12.0]), 0.01)
    np.testing.assert_allclose(far[:2], [0.38, 0.62], atol=1e-12)
    # Half the law is left at an end of the range: twice the probability of what is beyond is P(Z < -12).
    beyond = ndtr(-(1.0 - far[2]) / 0.01), ndtr(-far[3] / 0.01)
    np.testing.assert_allclose(2.0 * np.array(beyond), ndtr(-12.0), rtol=1e-6)
    wild = disturb(np.linspace(0.0, 1.0, 101), np.where(np.arange(101) % 2, -60.0, 60.0), SD)
    assert (wild >= 0.0).all()
    assert (wild <= 1.0).all()


def made_up(inputs, hidden):
    """Return weights in MetaDrive's form."""
    rng, sizes = np.random.default_rng(0), [(inputs, hidden), (hidden, hidden), (hidden, 4)]
    found = {}
    for name, size in zip(("fc_1", "fc_2", "fc_out"), sizes, strict=True):
        found[f"default_policy/{name}/kernel"] = rng.standard_normal(size) / size[0] ** 0.5
        found[f"default_policy/{name}/bias"] = 0.3 * rng.standard_normal(size[1])
    return {name: x.astype(np.float32) for name, x in found.items()}


@pytest.fixture
def weights():
    return made_up(20, 6)


def test_the_expert_is_what_its_authors_compute(tmp_path, weights):
    np.savez(tmp_path / "w.npz", **weights)
    seen = np.random.default_rng(1).uniform(size=(50, 20))
    turned = seen.copy()
    turned[:, [15, 10]] = 1.0 - turned[:, [15, 10]]
    values = turned.astype(np.float32)
    for name in ("fc_1", "fc_2", "fc_out"):
        values = values @ weights[f"default_policy/{name}/kernel"] + weights[f"default_policy/{name}/bias"]
        values = values if name == "fc_out" else np.tanh(values)
    network = expert.read(tmp_path / "w.npz")
    np.testing.assert_allclose(network(seen), np.clip(values[:, :2], -1.0, 1.0), atol=2e-5)
    assert network(seen).std(axis=0).min() > 0.05
    assert (abs(network(seen)) < 1.0).any(axis=0).all()
    assert network.provenance["license"] == "Apache-2.0"


def test_invalid_weights_are_refused(tmp_path, weights):
    np.savez(tmp_path / "pickled.npz", **{name: np.array([{}], dtype=object) for name in weights})
    weights.pop("default_policy/fc_2/bias")
    np.savez(tmp_path / "short.npz", **weights)
    (tmp_path / "text.npz").write_text("no weights")
    for name in ("pickled", "short", "text", "absent"):
        with pytest.raises(PluginError, match="not MetaDrive's expert"):
            expert.read(tmp_path / f"{name}.npz")
