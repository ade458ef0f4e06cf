"""Ids that installed distributions register are found without an import in the scenario."""

import sys

import gymnasium
import pytest
from gymnasium.envs import registration

from avrare.base.errors import UsageError
from avrare.plugin.registry import default_registry
from avrare.scenario.load import load
from avrare.stack.builder import build_stack
from avrare_gymnasium.config import GymnasiumConfig
from avrare_gymnasium.registration import register_installed_environments
from avrare_gymnasium.world import build

MODULE = """\
import gymnasium
from gymnasium.envs.classic_control import PendulumEnv

def register():
    gymnasium.register("Gusts-v0", entry_point=PendulumEnv, max_episode_steps=50)

def broken():
    raise RuntimeError("no wind")
"""
SCENARIO = """\
name: gusts
steps: 5
simulator: {plugin: gymnasium, env: %s, dt: 0.05}
controller: {plugin: gym_constant, action: [0.0]}
specifications: {up: {stl: "always (o0 > -2)"}}
estimator: {plugin: mc, rollouts: 3}
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install a distribution with these entry points; ids that it registers go afterwards."""

    def install(*points):
        info = tmp_path / "gusts-0.1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gusts\nVersion: 0.1\n")
        (info / "entry_points.txt").write_text("\n".join(["[gymnasium.envs]", *points, ""]))
        (tmp_path / "gusts.py").write_text(MODULE)
        monkeypatch.syspath_prepend(str(tmp_path))
        register_installed_environments.cache_clear()

    before = set(gymnasium.registry)
    yield install
    register_installed_environments.cache_clear()
    sys.modules.pop("gusts", None)
    for name in set(gymnasium.registry) - before:
        del gymnasium.registry[name]


@pytest.mark.parametrize(
    ("point", "name"), [("__root__ = gusts:register", "Gusts-v0"), ("wind = gusts:register", "wind/Gusts-v0")]
)
def test_an_id_of_an_entry_point_runs_in_a_scenario(installed, tmp_path, point, name):
    installed(point)
    path = tmp_path / "gusts.yaml"
    path.write_text(SCENARIO % name)
    default_registry.cache_clear()
    stack = build_stack(load(path))
    assert stack.loop.noise_size == 1
    assert name in gymnasium.registry


def test_a_broken_entry_point_is_named_where_an_id_is_not_found(installed):
    installed("calm = gusts:broken", "wind = gusts:register")
    with pytest.raises(UsageError, match="unknown environment 'Guts-v0'") as caught:
        build(GymnasiumConfig(env="Guts-v0")).reset([[0.0]])
    assert "gusts could not register its environments: RuntimeError: no wind" in caught.value.hint
    assert "wind/Gusts-v0" in gymnasium.registry
    assert registration.current_namespace is None


def test_known_ids_load_no_entry_points(installed):
    installed("__root__ = gusts:broken")
    build(GymnasiumConfig(env="CartPole-v1"))
    assert "gusts" not in sys.modules
