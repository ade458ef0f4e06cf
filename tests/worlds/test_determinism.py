"""Systems that break the rules are named before an estimate begins, and splitting refuses them."""

import random
import re
import time

import numpy as np
import pytest

import avrare
from avrare.testing.faulty_systems import Walk
from avrare.worlds.capabilities import Findings, probe

GENERATOR = np.random.default_rng(1)


class InPlace(Walk):
    def step(self, state, noise):
        state["x"] += self.scale * noise[:, 0]
        return state


class InNoise(Walk):
    def step(self, state, noise):
        noise *= self.scale
        return {"x": state["x"] + noise[:, 0]}


class InPlaceRarely(Walk):
    def step(self, state, noise):
        state["x"][state["x"] > 9.0] = 9.0
        return super().step(state, noise)


class InPlaceWhereItCan(Walk):
    """Asks for an array that it may write, which is a copy only where it may not."""

    def step(self, state, noise):
        x = np.require(state["x"], requirements="W")
        x += self.scale * noise[:, 0]
        return {"x": x}


class InPlaceBehindTheView(Walk):
    def initial(self, noise):
        self.x = np.zeros(len(noise))
        return {"x": self.x[:]}

    def step(self, state, noise):
        self.x += self.scale * noise[:, 0]
        return {"x": self.x[:]}


class Adds(Walk):
    """Adds a number, which ``more`` draws for all rows, to each step."""

    def __init__(self, more):
        super().__init__()
        self.more = more

    def step(self, state, noise):
        return {"x": self.move(state["x"], noise) + self.more(state["x"])}


class Remembers(Walk):
    """Keeps its state to itself, and returns a copy."""

    def initial(self, noise):
        self.x = np.zeros(len(noise))
        return {"x": self.x.copy()}

    def step(self, state, noise):
        self.x = self.move(self.x, noise)
        return {"x": self.x.copy()}


class Picky(Walk):
    """Refuses arrays that it may not write, as Cython does, and only reads them."""

    def step(self, state, noise):
        if not state["x"].flags.writeable:
            raise ValueError("buffer source array is read-only")
        return super().step(state, noise)


def estimate(system, estimator="mc", **options):
    problem = avrare.Problem(system, avrare.stl("always (x < 0.9)"), steps=12)
    sizes = {"mc": {"rollouts": 50}, "ams": {"particles": 20, "discard": 4, "runs": 2}}
    quiet = {"suppress": ["few_roots"]} if estimator == "ams" else {}
    return avrare.estimate(problem, estimator, **{**sizes[estimator], **quiet, **options})


@pytest.mark.parametrize("kind", [InPlace, InNoise, InPlaceRarely, InPlaceWhereItCan, InPlaceBehindTheView])
def test_a_step_that_changes_what_it_is_given_is_refused_by_splitting_alone(kind):
    system = kind()
    with pytest.raises(avrare.UsageError, match=r"ams must continue rollouts from others.* a step changes"):
        estimate(system, "ams")
    result, sound = estimate(system), estimate(Walk())
    np.testing.assert_array_equal(result.robustness, sound.robustness)
    assert not result.health


def test_the_line_that_writes_is_named():
    assert re.search(r"\(test_determinism\.py:\d+\)$", probe(InPlace()).in_place)


@pytest.mark.parametrize(
    ("more", "cause"),
    [
        (lambda x: 1e-3 * np.random.normal(size=len(x)), r"it reads numpy\.random"),
        (lambda x: 1e-3 * random.random(), r"it reads the module random at test_determinism\.py:\d+"),
        (lambda x: random.gauss(0.0, 1e-3), r"it reads the module random at test_determinism\.py:\d+"),
        (lambda x: 1e-6 * (time.perf_counter() % 1.0), r"it reads time\.perf_counter at test_determinism"),
        (lambda x: 1e-3 * GENERATOR.normal(), "it keeps a state of its own"),
    ],
)
def test_what_else_a_system_reads_is_said_in_words(more, cause):
    with pytest.raises(avrare.UsageError, match=cause):
        estimate(Adds(more), "ams")
    health = estimate(Adds(more)).health
    assert set(health) == {"not_deterministic"}
    assert re.search(cause, health["not_deterministic"])


def test_a_state_of_its_own_matters_where_a_rollout_branches():
    assert not estimate(Remembers()).health
    with pytest.raises(avrare.UsageError, match=r"'x' differs from step 6 on .* after a branch at step 5"):
        estimate(Remembers(), "ams")


def test_rows_that_depend_on_each_other():
    with pytest.raises(avrare.UsageError, match=r"from step 2 on .* with the other rows of its batch"):
        estimate(Adds(lambda x: 0.1 * x.mean()), "ams")
    assert set(estimate(Adds(lambda x: 0.1 * x.mean())).health) == {"not_deterministic"}


@pytest.mark.parametrize("estimator", ["mc", "ams"])
def test_rounding_by_the_size_of_the_batch_is_a_mild_warning(estimator):
    result = estimate(Adds(lambda x: 1e-9 * len(x)), estimator)
    assert set(result.health) == {"rounding"}
    assert re.search(r"replayed, differs by \d[.\d]*e-0[78]: rounding", result.health["rounding"])
    found = probe(Adds(lambda x: 1e-9 * len(x))).rounding
    assert "signal 'x' differs from step 1 on by up to 2e-08" in found


def test_a_system_that_changes_only_late_does_not_reproduce():
    health = estimate(Adds(lambda x: 0.1 * random.random() * (x.max() > 0.5))).health
    assert set(health) == {"not_deterministic"}


@pytest.mark.parametrize("system", [Walk(), Picky()])
def test_a_system_that_keeps_the_rules(system):
    assert probe(system) == Findings()
    assert not estimate(system, "ams").health


def test_an_error_is_counted_and_not_raised():
    class Broken(Walk):
        def step(self, state, noise):
            raise ZeroDivisionError

    assert probe(Broken()) == Findings()
    assert estimate(Broken()).errors == 50


def test_it_goes_unnoticed():
    before = random.getstate(), repr(np.random.get_state())
    probe(Adds(lambda x: random.random() + np.random.random()))
    assert before == (random.getstate(), repr(np.random.get_state()))


def test_each_health_warning_reaches_python():
    with pytest.warns(avrare.HealthWarning) as caught:
        result = estimate(Adds(lambda x: time.time()))
    assert set(result.health) == {"not_deterministic", "all_failed"}
    expected = [f"specification: {name}: {text}" for name, text in result.health.items()]
    assert [str(warning.message) for warning in caught] == expected
    assert {warning.filename for warning in caught} == {__file__}
