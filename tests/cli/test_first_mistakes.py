"""Mistakes of the first hours: what is wrong, where, and what to do next."""

from functools import partial

import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare.logic.formula import stl
from avrare.testing.faulty_systems import Walk

TANK = """\
name: t
steps: 4
simulator: {plugin: tank}
specifications: {dry: {stl: "always (level < 1.05)"}}
estimator: {plugin: mc, rollouts: 20}
"""


@pytest.fixture
def said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "t.yaml").write_text(TANK)

    def said(*words, code=4):
        assert main([*words]) == code
        return capsys.readouterr().err

    return said


@pytest.mark.parametrize("text", ["always (level < 1.05 m)", "always (2 level < 1)", "always (level < 3.m)"])
def test_a_number_with_a_unit_is_no_number_of_a_formula(text):
    with pytest.raises(UsageError) as caught:
        stl(text)
    assert caught.value.hint == (
        "numbers have no unit, only time bounds do, as in always[0:3s]; a product is written 3 * x"
    )


@pytest.mark.parametrize(
    ("words", "start"),
    [
        (("--seed", "-1"), "avrare run: --seed must be at least 0"),
        (("--until", "relative_error=-1"), "--until relative_error: should be greater"),
        (("--until", "threshold=7"), "--until threshold: should be less"),
        (("--learned", "learned.json"), "--learned: the scenario's estimator has no such option"),
        (("--set", "seed=-1"), "--set seed: should be greater"),
        (("--workers", "x"), "avrare run: --workers must be a whole number, not 'x'\nhint: see avrare run"),
        (("--budget", "500"), "budget '500' is not understood\nhint: write steps=1e6, rollouts=1000 or"),
    ],
)
def test_a_mistake_in_an_option_is_told_by_its_name(said, words, start):
    assert said("run", "t.yaml", *words).startswith(start)


@pytest.mark.parametrize(
    ("option", "names"), [(("--learned", "learned.json"), "is"), (("--until", "threshold=1e-3"), "auto, mc")]
)
def test_an_option_that_the_estimator_lacks_names_those_that_have_it(said, option, names):
    hint = said("run", "t.yaml", "--estimator", "ce", *option).splitlines()[1]
    assert hint == f"hint: add --estimator with one of {names}"


@pytest.mark.parametrize(
    "words",
    [
        ("run", "t.yaml", "--budget", "rollouts=0"),
        ("run", "t.yaml", "--budget", "rollouts"),
        ("run", "--out", "nothere", "--resume"),
        ("run", "t.yaml", "--out", ""),
        ("validate", "."),
        ("monitor", "nothere.csv", "--rule", "R_G1"),
        ("monitor", "t.yaml", "--rule", "R_G1"),
    ],
)
def test_every_error_says_what_to_do(said, words):
    assert "\nhint: " in said(*words)


@pytest.mark.parametrize("estimator", ["mc", "auto", "ams", "ess", "is", "ce", "smc"])
def test_an_infinite_memory_is_refused(said, estimator):
    error = said("validate", "t.yaml", "--estimator", estimator, "--set", "estimator.memory=.inf")
    assert "estimator.memory: should be a finite number, found inf" in error


@pytest.mark.parametrize("budget", [-1, 0, 2.5, float("nan"), "600"])
def test_a_search_needs_rollouts(budget):
    problem = avrare.Problem(Walk(), stl("always (x < 1)"), steps=3)
    with pytest.raises(UsageError, match="budget must be a number of rollouts of at least 1, not"):
        avrare.falsify(problem, budget=budget)


NO_ARRAY = "the noise is not an array of numbers"


@pytest.mark.parametrize(
    ("noise", "told"),
    [("worst", NO_ARRAY), ([[1.0], "x"], NO_ARRAY), ({}, NO_ARRAY), ([[float("nan")]] * 4, "holds NaN")],
)
def test_noise_that_is_no_array_of_numbers_is_refused(noise, told):
    problem = avrare.Problem(Walk(), stl("always (x < 1)"), steps=3)
    for take in (partial(avrare.trace, problem), problem.robustness):
        with pytest.raises(UsageError, match=told):
            take(noise)


def test_a_mistake_in_the_only_scene_does_not_make_the_scenes_too_few(said, tmp_path):
    scene = "{name: a, scenario: t.yaml, exposure: {count: 3, minutes: 10}}"
    (tmp_path / "c.yaml").write_text(f"name: c\nbudget: {{rollouts: 900}}\nscenes:\n  - {scene}\n")
    error = said("rate", "c.yaml")
    assert "c.yaml:4:54: scenes.0.exposure.minutes: unknown key" in error
    assert "at least 1 item" not in error
    (tmp_path / "c.yaml").write_text("name: c\nbudget: {rollouts: 900}\nscenes: []\n")
    assert "scenes: should have at least 1 item, found 0" in said("rate", "c.yaml")


def test_what_python_hands_over_by_mistake_is_refused(tmp_path):
    problem = avrare.Problem(Walk(), stl("always (x < 1)"), steps=3)
    with pytest.raises(UsageError, match="estimator must be a name, not 5"):
        avrare.estimate(problem, 5)
    plot = avrare.estimate(problem, "mc", rollouts=9).plot()
    with pytest.raises(UsageError, match="no plot can be written as 'xyz'"):
        plot.save(tmp_path / "plot.xyz")
    assert plot.save(tmp_path / "plot.SVG").exists()


class Clocked(Walk):
    dt = 0.1


@pytest.mark.parametrize("text", ["always[0:1s] (x < 3)", "always[0,1] (x < 3)", "once[0.5s:1s] (x < 3)"])
def test_a_formula_with_another_time_of_a_sample_is_refused(text):
    coarse = stl(text, dt=0.5)
    with pytest.raises(UsageError, match=r"takes 0.5 s for a sample, but a step .* 0.1 s") as caught:
        avrare.Problem(Clocked(), coarse, steps=20)
    assert caught.value.hint == "leave dt out, or give the formula the step: avrare.stl(..., dt=0.1)"
    with pytest.raises(UsageError, match="for a sample"):
        avrare.Problem(Clocked(), stl("always (x < 3)"), steps=20, score=coarse)
    avrare.Problem(Clocked(), stl(text, dt=0.1), steps=20)
    avrare.Problem(Walk(), coarse, steps=20)
    bound, fine = avrare.Problem(Clocked(), stl(text), steps=20), stl(text, dt=0.1)
    assert str(bound.monitors[0].formula) == str(fine)
    assert str(avrare.Problem(Clocked(), fine, steps=20, score=stl(text)).score) == str(fine)


def test_the_monitor_of_a_formula_takes_the_step_of_the_system_too():
    bound = avrare.Problem(Clocked(), stl("always[0:1s] (x < 3)").monitor(), steps=20)
    assert bound.monitors[0].formula.horizon == 10
    with pytest.raises(UsageError, match=r"takes 0.5 s for a sample, but a step .* 0.1 s"):
        avrare.Problem(Clocked(), stl("always[0:1s] (x < 3)", dt=0.5).monitor(), steps=20)


@pytest.mark.parametrize("dt", [0.0, -0.1, float("nan"), float("inf"), "0.1", True])
def test_a_step_is_a_positive_number(dt):
    system = type("Odd", (Walk,), {"dt": dt})()
    with pytest.raises(UsageError, match=r"Odd.dt must be a positive number, not"):
        avrare.Problem(system, stl("always (x < 3)"), steps=20)


def test_a_run_says_that_it_replaces_results(said):
    words = ("run", "t.yaml", "--out", "seen")
    assert "replaced" not in said(*words, code=0)
    assert "seen: its results are replaced when this run is finished\n" in said(*words, code=0)
