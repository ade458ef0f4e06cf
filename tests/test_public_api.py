"""The public interface, on the ten-line walk of the README."""

import inspect
import json
import math
import re
import subprocess
import sys
from dataclasses import is_dataclass
from functools import cached_property

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.analysis.causes.attribution import Attribution
from avrare.analysis.causes.kinds import Kinds
from avrare.base.plot import Plot
from avrare.base.records import Answer
from avrare.plugin import provided
from avrare.plugin.provided import FUNCTIONS
from avrare.scenario.schema import Block
from avrare.stack.builder import build_block
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import linear, reference_problem
from avrare_design.synthesis import Synthesis


def walk(limit=2.5, system=None, **keywords):
    return avrare.Problem(
        system or systems.Walk(), avrare.stl(f"always (x < {limit})"), steps=100, **keywords
    )


SETTINGS = {"mc": {"rollouts": 2000}, "ams": {"particles": 50, "discard": 10, "runs": 4}}


@pytest.fixture(scope="module", params=SETTINGS)
def result(request):
    return avrare.estimate(walk(), request.param, seed=3, **SETTINGS[request.param])


def test_attributes(result):
    low, high = result.interval
    assert isinstance(result.probability, float)
    assert type(low) is float
    assert type(high) is float
    assert 0.0 <= low < result.probability < high <= 1.0
    assert result.confidence == 0.95
    assert result.run_probabilities.shape == ((1,) if result.estimator == "mc" else (4,))
    assert result.run_probabilities.mean() == result.probability
    assert result.errors == 0
    assert result.relative_error > 0.0
    assert result.seconds > 0.0
    if result.estimator == "mc":
        assert (result.rollouts, result.simulated_steps) == (2000, 200_000)
        assert not result.health
    else:
        assert result.rollouts > 200
        assert 20_000 < result.simulated_steps < result.rollouts * 100


def test_failures_are_tapes_that_fail_again(result):
    failures = result.failures
    kept = len(failures.robustness)
    assert 0 < kept <= failures.count
    assert failures.noise.shape == (kept, 101, 1)
    np.testing.assert_array_equal(walk().robustness(failures.noise), failures.robustness)
    assert (failures.robustness <= 0.0).all()
    assert walk().robustness(result.worst.noise[None])[0] == result.worst.robustness
    assert result.worst.robustness == np.nanmin([*failures.robustness, result.worst.robustness])


def test_json_round_trip(result):
    entry = json.loads(result.to_json())
    for name in ("probability", "confidence", "rollouts", "simulated_steps", "errors", "relative_error"):
        assert entry[name] == getattr(result, name)
    assert tuple(entry["interval"]) == result.interval
    assert entry["failures"] == result.failures.count
    assert entry["run_probabilities"] == result.run_probabilities.tolist()
    assert entry["health"] == list(result.health)
    assert entry["verdict"] is None


def test_monte_carlo_is_the_default_and_correct():
    result = avrare.estimate(walk(), seed=1, rollouts=40_000)
    truth = reference_problem("d_rw_L2.5").probability
    assert result.estimator == "mc"
    assert abs(result.probability - truth) < 4 * math.sqrt(truth * (1 - truth) / 40_000)


@pytest.mark.parametrize("estimator", SETTINGS)
@pytest.mark.parametrize(
    "system", [odd_systems.NestedWalk(), odd_systems.TupleWalk(), odd_systems.ArrayWalk()]
)
def test_states_may_be_dataclasses_tuples_or_arrays(estimator, system):
    ours, dicts = (
        avrare.estimate(walk(1.0, one), estimator, seed=5, **SETTINGS[estimator])
        for one in (system, systems.Walk())
    )
    np.testing.assert_array_equal(ours.run_probabilities, dicts.run_probabilities)
    np.testing.assert_array_equal(ours.failures.noise, dicts.failures.noise)


@pytest.mark.parametrize("estimator", SETTINGS)
def test_static_problem(estimator):
    problem = linear(2.0, dim=3).problem()
    result = avrare.estimate(problem, estimator, seed=2, **SETTINGS[estimator])
    truth = linear(2.0, dim=3).probability
    trials = result.rollouts
    assert abs(result.probability - truth) < 4 * math.sqrt(truth / trials)
    assert result.simulated_steps == 0
    assert result.failures.noise.shape == (len(result.failures.robustness), 1, 3)
    np.testing.assert_array_equal(problem.robustness(result.failures.noise), result.failures.robustness)


def test_failure_is_the_boolean_evaluation():
    class Fixed(systems.Walk):
        def step(self, state, noise):
            return {"x": np.full(len(noise), 4.0)}

    touching, allowed = (
        avrare.estimate(avrare.Problem(Fixed(), avrare.stl(text), steps=1), rollouts=10)
        for text in ("always (x < 4)", "always (x <= 4)")
    )
    assert (touching.probability, allowed.probability) == (1.0, 0.0)
    assert touching.failures.robustness.tolist() == [0.0] * 10


USAGE = {
    "option": ({"rolouts": 5}, "rolouts", "rollouts"),
    "argument": ({"worker": 2}, "worker", "workers"),
    "option of another": ({"particles": 5}, "particles", "rollouts"),
    "bad value": ({"rollouts": 0}, "rollouts", None),
    "no number": ({"rollouts": "many"}, "rollouts", None),
    "discard": ({"estimator": "ams", "particles": 10, "discard": 10}, "discard", None),
    "negative seed": ({"seed": -1}, "seed", None),
    "float seed": ({"seed": 1.5}, "seed", None),
    "workers": ({"workers": 0}, "workers", None),
    "workers is a flag": ({"workers": True}, "workers", None),
    "confidence 0": ({"confidence": 0.0}, "confidence", None),
    "confidence 1": ({"confidence": 1}, "confidence", None),
    "confidence in percent": ({"confidence": 95}, "confidence", None),
    "confidence nan": ({"confidence": math.nan}, "confidence", None),
    "confidence text": ({"confidence": "high"}, "confidence", None),
    "budget kind": ({"budget": "step=100"}, "step", "steps"),
    "budget amount": ({"budget": "steps=lots"}, "lots", None),
    "budget zero": ({"budget": {"steps": 0}}, "steps", None),
    "budget negative": ({"budget": {"rollouts": -5}}, "rollouts", None),
    "budget number": ({"budget": 1000}, "1000", "steps=1e6"),
    "two budgets": ({"budget": {"steps": 5, "rollouts": 5}}, "budget", "steps=1e6"),
    "too small": ({"budget": "steps=99"}, "does not pay", "100"),
    "too small for splitting": ({"estimator": "ams", "budget": "rollouts=99"}, "does not pay", "particles"),
    "clock and runs": ({"budget": "seconds=1", "runs": 3}, "seconds", "steps=N"),
    "splitting by the clock": ({"estimator": "ams", "budget": "seconds=1"}, "clock", "steps=N"),
}


@pytest.mark.parametrize("name", USAGE)
def test_usage_errors_have_a_message_and_a_hint(name):
    arguments, message, hint = USAGE[name]
    with pytest.raises(avrare.UsageError) as caught:
        avrare.estimate(walk(), **arguments)
    assert message in str(caught.value)
    assert hint is None or hint in caught.value.hint


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"steps": -1}, "steps"),
        ({"steps": 2.0}, "steps"),
        ({"steps": True}, "steps"),
        ({"score": "margine"}, "margine"),
        ({"chunk": 0}, "chunk"),
        ({"specification": "always (x < 4)"}, "not a specification"),
        ({"specification": {}}, "specification"),
        ({"system": object()}, "noise_size, initial, step, signals"),
    ],
)
def test_problem_checks_its_arguments(arguments, message):
    default = {"system": systems.Walk(), "specification": avrare.stl("always (x < 4)"), "steps": 10}
    with pytest.raises(avrare.UsageError, match=message):
        avrare.Problem(**{**default, **arguments})


def test_several_specifications_need_the_command_line():
    formulas = {name: avrare.stl("always (x < 4)") for name in ("one", "two")}
    with pytest.raises(avrare.UsageError, match="2 specifications"):
        avrare.estimate(avrare.Problem(systems.Walk(), formulas, steps=3))


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        (lambda x: {"x": x[:-1]}, r"'x' has shape \(9,\)"),
        (lambda x: {"x": x, "y": 3.0}, "'y' has shape float"),
        (lambda x: {"x": x.sum()}, r"'x' has shape \(\)"),
        (lambda x: {"x": list(x)}, "'x' has shape list"),
        (lambda x: x, "signals"),
        (lambda x: {"y": x}, "'x' is missing"),
        (lambda x: {"x": np.stack([x, x], axis=1)}, "trailing ax"),
    ],
)
def test_signals_of_the_wrong_shape(signals, message):
    class Odd(systems.Walk):
        def signals(self, state):
            return signals(state["x"])

    with pytest.raises(avrare.UsageError, match=message):
        avrare.estimate(walk(system=Odd()), rollouts=10)


@pytest.mark.parametrize("state", [[np.zeros(50)], {"x": np.zeros(50), "t": np.array(0)}, {"x": {1, 2}}])
def test_states_that_cannot_be_copied(state):
    class Odd(systems.Walk):
        def initial(self, noise):
            return state

        def step(self, state, noise):
            return state

        def signals(self, state):
            return {"x": np.zeros(50)}

    with pytest.raises(avrare.UsageError, match="state"):
        avrare.estimate(walk(system=Odd()), "ams", particles=50, discard=5, runs=1)


def test_noise_of_the_wrong_shape():
    with pytest.raises(avrare.UsageError, match=r"\(N, 101, 1\)"):
        walk().robustness(np.zeros((4, 100, 1)))


def test_public_names():
    for name in avrare.__all__:
        assert getattr(avrare, name) is not None
        assert name in dir(avrare)
    with pytest.raises(AttributeError, match="estimatte"):
        _ = avrare.estimatte
    assert {*FUNCTIONS} <= {*dir(avrare)}
    assert issubclass(avrare.FormulaError, avrare.UsageError)


def test_a_function_of_a_missing_distribution_names_the_pip_line(monkeypatch):
    monkeypatch.setattr(provided, "entry_points", lambda **_: ())
    with pytest.raises(avrare.PluginError, match=r"avrare\.require is provided by avrare-design") as caught:
        provided.load_function("require")
    assert caught.value.hint == "pip install avrare-design"


def test_the_readme_example_runs_in_a_bare_process():
    code = """
import numpy as np, avrare
class Walk:
    noise_size = 1
    def initial(self, noise): return {"x": np.zeros(len(noise))}
    def step(self, state, noise): return {"x": state["x"] + 0.1 * noise[:, 0]}
    def signals(self, state): return {"x": state["x"]}
problem = avrare.Problem(Walk(), avrare.stl("always (x < 2.5)"), steps=100)
print(avrare.estimate(problem, rollouts=2000, seed=3).probability)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == avrare.estimate(walk(), rollouts=2000, seed=3).probability


def list_functions(value):
    """Return a function, or the public functions and properties of a class, by name."""
    if not isinstance(value, type):
        return {value.__name__: value}
    inner = {property: "fget", cached_property: "func", staticmethod: "__func__", classmethod: "__func__"}
    members = {
        name: getattr(member, inner.get(type(member), ""), member) for name, member in vars(value).items()
    }
    return {
        f"{value.__name__}.{name}": member
        for name, member in members.items()
        if inspect.isfunction(member)
        if not name.startswith("_") or (name == "__init__" and not is_dataclass(value))
    }


def find_classes(annotation, module):
    """Return the classes of this project that an annotation of a module names.

    Those of ``avrare.protocols`` are contracts: their states are of any type.
    """
    names = vars(sys.modules[module])
    values = [names.get(word) for word in re.findall(r"\w+", str(annotation))]
    classes = [value for value in values if isinstance(value, type)]
    return [value for value in classes if re.match(r"avrare(_\w+)?\.(?!protocols)", value.__module__)]


def test_no_public_signature_is_untyped():
    todo = [value for name in avrare.__all__ if callable(value := getattr(avrare, name))]
    todo += [build_block, Block]
    walked, untyped = set(), set()
    while todo:
        value = todo.pop()
        if value in walked:
            continue
        walked.add(value)
        for name, function in list_functions(value).items():
            annotations = {key: str(text) for key, text in function.__annotations__.items()}
            parameters = {*inspect.signature(function).parameters, "return"} - {"self", "cls"}
            untyped |= {(name, key) for key in parameters - set(annotations)}
            untyped |= {(name, key) for key, text in annotations.items() if re.search(r"\bAny\b", text)}
            todo += find_classes(annotations.get("return", ""), function.__module__)
        if isinstance(value, type) and issubclass(value, Answer):
            for text in inspect.get_annotations(value).values():
                todo += find_classes(text, value.__module__)
    assert {avrare.Result, avrare.Run, avrare.Trace, Plot, Kinds, Attribution, Synthesis} <= walked
    assert not untyped, sorted(untyped)


def test_a_problem_is_falsified_and_compared_as_a_scenario_is():
    problem = avrare.Problem(
        systems.Walk(),
        {"low": avrare.stl("always (x < 1.5)"), "high": avrare.stl("always (x < 9)")},
        steps=40,
    )
    found = avrare.falsify(problem, "low", budget=300)
    assert problem.subset(["low"]).robustness(found.noise[None])[0] <= 0.0
    assert repr(found).splitlines()[-2] == f"beta = {found.norm:.3g}"
    assert found.table()[0]["beta"] == found.norm
    comparison = avrare.compare(problem, ["mc", "ams:particles=40"], "rollouts=400", "low", repeat=2)
    assert [row["estimator"] for row in comparison.table()] == ["mc", "ams:particles=40"]
    assert repr(comparison).startswith("Walk  low  p ")
    with pytest.raises(avrare.UsageError, match="specification must be named"):
        avrare.falsify(problem)
    with pytest.raises(avrare.UsageError, match="unknown specification 'lo'"):
        avrare.falsify(problem, "lo")


def test_a_mistake_in_a_file_is_a_value(tmp_path):
    (tmp_path / "s.yaml").write_text("name: s\nsteps: no\n")
    found = avrare.validate(tmp_path / "s.yaml")
    assert not found.valid
    assert any("s.yaml:2:8" in text for text, _ in found.mistakes)
    assert {row["sort"] for row in found.table()} == {"mistake"}
