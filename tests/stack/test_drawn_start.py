"""Scenes drawn from row 0 of the tape: correlated, drawn again where impossible, one estimate over all."""

import numpy as np
import pytest

from avrare import estimate
from avrare.base.errors import PluginError
from avrare.cli.main import main
from avrare.rollout.loaded_scenario import load
from avrare.rollout.replay import replay_tape

SCENE = """\
name: drawn
steps: 4
simulator:
  plugin: single_track
  ego:
    x: 0.0
    y: 1.75
    speed: {law: normal, mean: 20.0, sd: 1.0}
  vehicles:
    - name: van
      x: {law: uniform, low: 0.0, high: 20.0}
      y: 1.75
      speed: 20.0
  draws:
    correlations: [{between: [ego.speed, vehicles.van.x], value: 0.8}]
tracker: {plugin: imm}
controller: {plugin: mpc, backend: casadi, horizon: 4}
specifications:
  apart: {stl: "always (gap > 2)"}
"""


@pytest.fixture
def loaded(tmp_path):
    def loaded(*overrides, text=SCENE):
        path = tmp_path / "s.yaml"
        path.write_text(text)
        return load(path, overrides)

    return loaded


def noise(n, size, seed=0):
    return np.random.default_rng(seed).standard_normal((n, size))


def start(scenario, n=400):
    loop = scenario.stack.loop
    state = loop.initial(noise(n, loop.noise_size))
    return loop, state, loop.signals(state)


KEPT = ("simulator.draws.broken_rule=keep", "simulator.vehicles.0.x={law: uniform, low: 10, high: 40}")


def test_values_are_signals_with_their_law_and_correlation(loaded):
    loop, _, signals = start(loaded(*KEPT), 4000)
    speed, x = signals["drawn_ego_speed"], signals["drawn_vehicles_van_x"]
    assert speed.mean() == pytest.approx(20.0, abs=0.05)
    assert speed.std() == pytest.approx(1.0, abs=0.04)
    assert (x.min(), x.max()) == (pytest.approx(10.0, abs=0.2), pytest.approx(40.0, abs=0.2))
    # Spearman's rho of a Gaussian copula: 6/pi asin(r/2)
    ranks = [np.argsort(np.argsort(values)) for values in (speed, x)]
    assert np.corrcoef(ranks)[0, 1] == pytest.approx(6 / np.pi * np.arcsin(0.4), abs=0.03)
    assert (signals["ego_speed"] == speed).all()
    assert (signals["others_x"][:, 0] == x).all()
    assert loop.noise_names[:2] == ("draw of ego.speed", "draw of vehicles.van.x")


def test_impossible_scenes_are_drawn_again_and_counted(loaded):
    loop, state, signals = start(loaded())
    first = loaded(*KEPT[:1], "simulator.draws.overlap=error").stack.loop
    bare = first.initial(noise(400, first.noise_size))
    impossible = first.signals(bare)["gap"] <= 2.0
    assert impossible.sum() > 50
    assert (signals["gap"] > 2.0).all()
    assert (state.drawn.redraws[impossible] >= 1).all()
    assert (state.drawn.redraws[~impossible] == 0).all()
    assert not state.drawn.refused.any()
    assert (loop.counts(state)["scenes_redrawn"] == state.drawn.redraws).all()
    kept = signals["drawn_vehicles_van_x"][~impossible]
    assert (kept == first.signals(bare)["drawn_vehicles_van_x"][~impossible]).all()


def test_impossible_scenes_may_be_errors(loaded):
    loop, state, signals = start(loaded("simulator.draws.overlap=error", "simulator.draws.broken_rule=keep"))
    overlapping = signals["gap"] <= 0.0
    assert overlapping.any()
    assert (loop.faults(state) == overlapping).all()
    assert not state.drawn.redraws.any()


def test_a_start_without_a_possible_scene_is_an_error(loaded):
    van = "simulator.vehicles.0.x={law: truncated, of: {law: normal, mean: 0, sd: 1}, low: -2, high: 2}"
    loop = loaded(van, "simulator.draws.attempts=3", "specifications.apart.stl=always (gap > -9)").stack.loop
    state = loop.initial(noise(5, loop.noise_size))
    assert loop.faults(state).all()
    assert (state.drawn.redraws == 2).all()


def test_a_broken_rule_may_be_kept_as_a_failure(loaded):
    scenario = loaded(*KEPT, "specifications.apart.stl=always (gap > 20.5)")
    broken = (start(scenario, 2000)[2]["gap"] <= 20.5).mean()
    result = estimate(scenario.problem("apart"), "mc", rollouts=60, seed=1)
    assert broken == pytest.approx(0.49, abs=0.04)
    assert result.probability >= 0.35
    resampled = loaded(KEPT[1], "specifications.apart.stl=always (gap > 20.5)")
    assert (start(resampled, 200)[2]["gap"] > 20.5).all()


def test_a_replayed_tape_is_the_same_scene(loaded):
    problem = loaded().problem("apart")
    tape = noise(5, problem.system.noise_size, seed=3)
    one, other = (replay_tape(problem, tape) for _ in range(2))
    assert (one.signals["drawn_ego_speed"] == other.signals["drawn_ego_speed"]).all()
    assert len(set(one.signals["drawn_ego_speed"])) == 1


def test_a_simulator_that_only_marks_its_options_is_refused(loaded, monkeypatch):
    monkeypatch.delattr("avrare_single_track.simulator.SingleTrack.reset_drawn")
    with pytest.raises(PluginError, match="marks options as drawable"):
        loaded().stack  # noqa: B018  # built on first use


def test_validate_draws_a_few_scenes(loaded, tmp_path, capsys):
    loaded()
    assert main(["validate", "--build", str(tmp_path / "s.yaml")]) == 0
    assert "2 options drawn, 50 scenes tried: " in capsys.readouterr().out
    hopeless = "simulator.vehicles.0.x={law: uniform, low: -1.0, high: 1.0}"
    settings = ["specifications.apart.stl=always (gap > -9)", "simulator.draws.attempts=2", hopeless]
    words = [word for setting in settings for word in ("--set", setting)]
    assert main(["validate", "--build", str(tmp_path / "s.yaml"), *words]) == 4
    assert "each of 50 drawn scenes is impossible" in capsys.readouterr().err
