"""The simulator ``transformed``: scenarios with noise that is not normal."""

import math

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy import stats

import avrare
from avrare.base.errors import AvrareError
from avrare.scenario.fingerprint import digests, fingerprint
from avrare.scenario.load import load
from avrare_flows import marginals as m
from avrare_flows.config import LawConfig, TransformedConfig
from avrare_flows.flow import Flow
from avrare_flows.simulator import build, law_of

SUM = """
name: sum
steps: 0
simulator:
  plugin: transformed
  noise: {{law: exponential}}
  {extra}
  simulator:
    plugin: linear
    states: [x, y]
    A: [[1, 0], [0, 1]]
    initial: {{mean: [0, 0], covariance: [1, 1]}}
specifications:
  low: {{stl: "x + y < 10"}}
estimator: {{plugin: ess}}
"""


def scenario(tmp_path, text):
    path = tmp_path / "sum.yaml"
    path.write_text(text)
    return avrare.load(path)


@pytest.mark.slow
def test_a_scenario_runs_on_physical_noise(tmp_path):
    loaded = scenario(tmp_path, SUM.format(extra=""))
    result = avrare.estimate(loaded.problem("low"), "ess", seed=1, runs=20)
    exact = math.exp(-10.0) * 11.0
    assert abs(result.probability - exact) < 3.5 * result.relative_error * result.probability
    assert result.relative_error < 0.15


def test_a_correlation_correlates_the_numbers(tmp_path):
    loaded = scenario(tmp_path, SUM.format(extra="correlation: [[1, 0.9], [0.9, 1]]"))
    z = np.random.default_rng(0).standard_normal((1000, 2))
    signals = loaded.stack.loop.signals(loaded.stack.loop.initial(z))
    assert np.corrcoef(signals["x"], signals["y"])[0, 1] > 0.8


def test_a_flow_from_a_file_gives_a_warning(tmp_path):
    Flow("affine_coupling", (), np.zeros(2), np.ones(2), samples=500).save(tmp_path / "flow.npz")
    text = SUM.replace("noise: {{law: exponential}}", f"flow: {tmp_path / 'flow.npz'}")
    problem = scenario(tmp_path, text.format(extra="").replace("< 10", "< 3")).problem("low")
    result = avrare.estimate(problem, "ess", seed=1, runs=10)
    assert "fitted to 500 samples" in result.health["model_error"]
    exact = stats.norm.sf(3.0 / math.sqrt(2.0))
    assert abs(result.probability - exact) < 4.0 * result.relative_error * result.probability


def test_the_wrapped_simulator_gives_dt_and_all_laws_are_known():
    config = {"plugin": "linear", "dt": 0.5, "states": ["x"], "A": [[1]], "initial": {"mean": [0]}}
    law = {"law": "uniform", "low": -1, "high": 1}
    options = TransformedConfig(simulator=config, noise=law, initial=[{"law": "normal", "std": 2}])
    built = build(options)
    assert (options.dt, built.dt, built.noise_size) == (0.5, 0.5, 1)
    assert isinstance(built.law.laws[0], m.Uniform)
    assert isinstance(built.first.laws[0], m.Normal)


@pytest.mark.parametrize(
    ("written", "peer"),
    [
        ({"law": "normal", "mean": 1, "std": 2}, stats.norm(1, 2)),
        ({"law": "lognormal", "std": 0.5}, stats.lognorm(0.5)),
        ({"law": "exponential", "scale": 3}, stats.expon(scale=3)),
        ({"law": "weibull", "shape": 2, "scale": 3}, stats.weibull_min(2, scale=3)),
        ({"law": "gamma", "shape": 2}, stats.gamma(2)),
        ({"law": "gumbel", "location": 1}, stats.gumbel_r(1)),
        ({"law": "student_t", "freedom": 5}, stats.t(5)),
        ({"law": "scipy", "name": "logistic", "options": {"scale": 2}}, stats.logistic(scale=2)),
        ({"law": "normal", "low": -1, "high": 2}, stats.truncnorm(-1, 2)),
        ({"law": "mixture", "weights": [1], "laws": [{"law": "gamma", "shape": 2}]}, stats.gamma(2)),
    ],
)
def test_a_law_is_that_of_scipy(written, peer):
    law = law_of(TypeAdapter(LawConfig).validate_python(written))
    z = np.array([-3.0, -0.5, 0.7, 4.0])
    expected = np.where(z <= 0, peer.ppf(stats.norm.cdf(z)), peer.isf(stats.norm.sf(z)))
    np.testing.assert_allclose(m.from_normal(law, z), expected, rtol=1e-8, atol=1e-12)


def test_the_options_of_a_beam_are_its_arguments():
    written = {"law": "beam", "distance": 4, "most": 10, "std": 0.1, "decay": 2, "hit": 0.9, "nothing": 0.1}
    law = law_of(TypeAdapter(LawConfig).validate_python(written))
    assert m.from_normal(law, np.array([3.0]))[0] == 10.0


@pytest.mark.parametrize(
    ("extra", "text"),
    [
        ("flow: x.npz", "either noise or flow"),
        ("correlation: [[1]]", "correlation has shape"),
        ("initial: [{law: normal}, {law: normal}, {law: normal}]", "3 numbers a row"),
        ("initial: {law: scipy, name: norms}", "no continuous distribution"),
        ("initial: {law: normal, low: 60}", "Normal has no probability"),
    ],
)
def test_mistakes_are_reported_without_a_traceback(extra, text, tmp_path):
    with pytest.raises(AvrareError, match=text):
        _ = scenario(tmp_path, SUM.format(extra=extra)).stack


def test_only_a_simulator_with_normal_noise_is_wrapped():
    noise = {"law": "exponential"}
    linear = {"plugin": "linear", "states": ["x"], "A": [[1]], "initial": {"mean": [0]}}
    inner = {"plugin": "transformed", "noise": noise, "simulator": linear}
    with pytest.raises(AvrareError, match="another transformed"):
        build(TransformedConfig(noise=noise, simulator=inner))
    road = {"plugin": "single_track", "ego": {"x": 0.0, "y": 0.0, "speed": 10.0}}
    with pytest.raises(AvrareError, match="'single_track' has no noise"):
        build(TransformedConfig(noise=noise, simulator=road))


def test_the_files_and_the_plugin_of_the_other_simulator_belong_to_the_fingerprint(tmp_path):
    (tmp_path / "scene.xml").write_text("one")
    text = f"""
name: recorded
steps: 1
simulator:
  plugin: transformed
  noise: {{law: exponential}}
  simulator: {{plugin: commonroad, file: {tmp_path}/scene.xml}}
specifications:
  low: {{stl: "x < 10"}}
estimator: {{plugin: ess}}
"""
    (tmp_path / "sum.yaml").write_text(text)
    definition = load(tmp_path / "sum.yaml")
    first = fingerprint(definition)
    assert definition.versions["avrare-single-track"]
    assert list(digests(definition)) == ["simulator.simulator.file"]
    (tmp_path / "scene.xml").write_text("two")
    assert fingerprint(definition) != first
