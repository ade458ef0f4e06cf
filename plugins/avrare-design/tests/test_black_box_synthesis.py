"""Synthesis that knows nothing of the system, against the exact gradients of a linear one."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

import avrare
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.errors import Interrupted, ScenarioError, UsageError
from avrare.cli.main import main
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare_design.descent import Search, descend
from avrare_design.scenario_numbers import ScenarioNumbers
from avrare_design.scenario_parameters import ParametricScenario
from avrare_linear.estimator import LinearLevels
from avrare_linear.estimator_config import LinearEssConfig
from feedback_loop import feedback_loop

LOOP = feedback_loop(4000, '  slow: {stl: "always (abs(v) < 1.2)"}\n')
GAIN = "simulator.feedback.gain"


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "loop.yaml"
    file.write_text(LOOP)
    return file


def numbers_of(path, *paths):
    return ScenarioNumbers.of(ParametricScenario(path, ()), paths or (GAIN,))


def measure(loaded, number):
    problem = loaded.problem("near")
    [result] = run(problem, loaded.estimator(), SerialExecutor(), Settings(number))
    return result


def exact_probability(loaded):
    estimator = LinearLevels(LinearEssConfig(chains=100, runs=10))
    [result] = run(loaded.problem("near"), estimator, SerialExecutor(), Settings(99))
    return result.probability


def test_numbers_have_names_sizes_and_settings(path):
    numbers = numbers_of(path, GAIN, "simulator.initial.mean", "simulator.dt")
    means = ("simulator.initial.mean.0", "simulator.initial.mean.1")
    assert numbers.names == (f"{GAIN}.0.0.0", f"{GAIN}.0.0.1", *means, "simulator.dt")
    assert numbers.scale[[0, 1, 2, 3]].tolist() == [0.3, 0.4, 1.0, 1.0]
    moved = numbers.at(numbers.start + np.array([0.0, 0.1, 1e-5, 0.0, 0.05])).definition.resolved["simulator"]
    assert moved["feedback"]["gain"] == [[[0.3, 0.5]]]
    assert moved["initial"]["mean"] == [1e-5, 0.0]
    assert moved["dt"] == pytest.approx(numbers.start[4] + 0.05)


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        ("simulator.states", "simulator.states has no numbers"),
        ("simulator.feedback.gian", "is not a number of this scenario"),
        ("controller.arrays.W0", "is not a number of this scenario"),
        ("simulator.plugin", "has no numbers"),
    ],
)
def test_paths_without_numbers_are_refused(path, parameter, text):
    with pytest.raises(UsageError, match=text):
        numbers_of(path, parameter)


@pytest.mark.slow
def test_the_gradient_is_that_of_exact_slices(path):
    numbers, search = numbers_of(path), Search("near", iterations=2, step=0.1)
    first = next(iter(descend(numbers, search, measure, TapeRunner())))
    found = np.array([one.value for one in first.derivatives])
    error = np.array([one.error for one in first.derivatives])
    truth = []
    for k in range(2):
        ends = [numbers.at(numbers.start * (1 + end * 0.1 * np.eye(2)[k])) for end in (-1, 1)]
        low, high = map(exact_probability, ends)
        truth.append(np.log(high / low) / 0.2)
    assert (np.abs(found - truth) < 4.0 * error + 0.1 * np.abs(truth)).all(), (found, error, truth)


def test_it_descends_and_takes_bad_steps_back(path):
    numbers, search = numbers_of(path), Search("near", iterations=4, seed=1)
    seen = []

    def pretend(loaded, number):
        seen.append(loaded.definition.resolved["simulator"]["feedback"]["gain"][0])
        found = measure(loaded, 0)
        if number == 1:  # the first step seems bad
            return replace(found, probability=1.0)
        if number == 2:
            raise ScenarioError([("refused", None)])
        return found

    done = list(descend(numbers, search, pretend, TapeRunner()))
    assert [one.best for one in done] == [True, False, False, True]
    assert done[2].measured is None
    assert [one.refusal for one in done] == ["", "", "refused", ""]
    steps = np.array([one.values for one in done]) - numbers.start
    np.testing.assert_allclose(steps[2], steps[1] / 2.0)
    np.testing.assert_allclose(steps[3], steps[1] / 4.0)
    assert done[3].measured.probability < done[0].measured.probability
    assert done[3].gradient is None, "the last iteration needs none"


def test_an_interruption_ends_the_descent(path):
    def interrupted(loaded, number):
        if number == 1:
            raise Interrupted("interrupted")
        return measure(loaded, number)

    with pytest.raises(Interrupted):
        list(descend(numbers_of(path), Search("near", 3), interrupted, TapeRunner()))


def test_a_difference_that_the_scenario_refuses_ends_the_descent_where_it_is(path):
    class Bounded(ScenarioNumbers):
        def at(self, values):
            if (values > 1.12 * self.start).any():
                raise ScenarioError([("too large", None)])
            return super().at(values)

    one = numbers_of(path)
    numbers = Bounded(one.scenario, one.paths, one.arrays)
    *_, last = descend(numbers, Search("near", 6), measure, TapeRunner())
    assert last.best
    assert last.refusal == "too large"
    assert last.gradient is None
    with pytest.raises(ScenarioError, match="too large"):
        next(iter(descend(numbers, Search("near", 6, step=0.2), measure, TapeRunner())))


def test_directions_span_the_gradient(path):
    numbers = numbers_of(path)
    searches = (Search("near", 2, directions=k) for k in (0, 2, 1))
    whole, part, one = (next(iter(descend(numbers, search, measure, TapeRunner()))) for search in searches)
    error = np.linalg.norm([one.error for one in (*whole.derivatives, *part.derivatives)])
    assert np.abs(part.gradient - whole.gradient).max() < 3.0 * error
    assert len(part.derivatives) == 2
    assert len(one.derivatives) == 1
    assert one.slope < whole.slope + 3.0 * error


def test_a_target_ends_it_and_maximising_climbs(path):
    numbers = numbers_of(path)
    assert len(list(descend(numbers, Search("near", 5, target=0.5), measure, TapeRunner()))) == 1
    searches = (Search("near", 2, maximise=maximise) for maximise in (False, True))
    down, up = (list(descend(numbers, search, measure, TapeRunner())) for search in searches)
    assert down[1].measured.probability < down[0].measured.probability < up[1].measured.probability
    assert [one.best for one in up] == [True, True]


@pytest.mark.slow
def test_the_command_proves_that_p_fell(path, tmp_path, capsys):
    out = tmp_path / "better" / "scenario.yaml"
    arguments = ["synthesise", str(path), "--specification", "near", "--parameter", GAIN, "--steps", "3"]
    assert main([*arguments, "--proof", "rollouts=8000", "--out", str(out.parent)]) == 0
    text = capsys.readouterr().out
    assert "the same 8,000 fresh tapes" in text
    assert "it fell:" in text
    assert "McNemar p = " in text
    before, after = (exact_probability(avrare.load(one)) for one in (path, out))
    assert after < 0.8 * before
    assert yaml.safe_load(out.read_text())["simulator"]["feedback"]["gain"] != [[0.3, 0.4]]


@pytest.mark.slow
def test_estimates_prove_it_where_the_start_is_rare(path, capsys):
    arguments = ["synthesise", str(path), "--specification", "near", "--parameter", GAIN, "--steps", "2"]
    rare = ('specifications.near.stl="always (x < 2.4)"', "estimator={plugin: ess, chains: 20}")
    code = main([*arguments, "--set", rare[0], "--set", rare[1]])
    text = capsys.readouterr().out
    assert "fresh estimates, at 95.0% together:" in text
    assert (code == 0) == ("it fell: the intervals do not meet" in text)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--parameter", GAIN, "--rate", "1"], "--rate is not an option for a parameter with a dot"),
        (["--parameter", "gain", "--budget", "rollouts=9"], "--budget is not an option for a linear system"),
        (["--parameter", "gain", "--parameter", "mean"], "one parameter of a linear system at a time"),
        (["--parameter", GAIN, "--set", 'specifications.near.stl="always (x < 99)"'], "no failure was found"),
        (["--parameter", GAIN, "--proof", "seconds=3"], "--proof must be rollouts=N"),
        (["--parameter", GAIN, "--target", "nan"], "a probability between 0 and 1, not nan"),
        (["--parameter", GAIN, "--out", "/dev/null"], "/dev/null: cannot write"),
    ],
)
def test_mistakes_are_reported(path, arguments, text, capsys):
    assert main(["synthesise", str(path), "--specification", "near", *arguments]) == 4
    assert text in capsys.readouterr().err


def test_stored_failures_begin_the_descent(path, tmp_path, capsys):
    folder = tmp_path / "run"
    assert main(["run", str(path), "--out", str(folder), "--quiet", "--no-pictures"]) == 0
    stored = json.loads((folder / "result.json").read_text())
    arguments = ["synthesise", str(path), "--specification", "near", "--parameter", GAIN, "--steps", "1"]
    main([*arguments, "--run", str(folder)])
    line = capsys.readouterr().out.splitlines()[-2]
    [near] = [one for one in stored["estimates"] if one["specification"] == "near"]
    assert float(line.split()[1]) == pytest.approx(near["probability"], rel=0.02)
