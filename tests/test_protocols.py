"""Contracts: plain classes get the defaults of their kind's base class, and wrappers forward."""

import pickle

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.driving import Observation
from avrare.protocols import Executor, PerceptionErrorModel, Simulator, System, SystemWrapper, adapt
from avrare.testing.faulty_systems import Fragile, Walk


class Plain:
    """A system of a class without a base."""

    noise_size = 1
    scene = None
    lives = 9

    def initial(self, noise):
        return {"x": noise[:, 0]}

    def step(self, state, noise):
        return {"x": state["x"] + noise[:, 0]}

    def signals(self, state):
        return state

    def faults(self, state):
        return state["x"] > 1.0


class Camera:
    """A perception error model of a class without a base."""

    noise_size = 0

    def observe(self, world, noise):
        return Observation(np.ones((len(noise), 1), bool), *np.zeros((3, len(noise), 1)))


def test_a_plain_class_gets_the_defaults_that_it_lacks():
    system = adapt(System, Plain())
    assert system.scene is None
    assert system.warnings == {}
    assert system.counts({"x": np.zeros(2)}) == {}
    assert system.faults({"x": np.array([0.0, 2.0])}).tolist() == [False, True]
    assert system.lives == 9
    assert not hasattr(system, "wings")


def test_a_default_may_call_the_methods_of_the_plain_class():
    observation, memory = adapt(PerceptionErrorModel, Camera()).follow(None, np.zeros((3, 0)), "kept")
    assert observation.detected.shape == (3, 1)
    assert memory == "kept"


class Here:
    def open(self, work): ...
    def map(self, chunks): ...
    def close(self): ...


def test_an_executor_counts_its_restarts_where_it_likes():
    class Counting(Here, Executor):
        def open(self, work):
            self.restarts += 1

    executor = Counting()
    executor.open(None)
    assert (executor.restarts, Counting.restarts) == (1, 0)


def test_a_part_with_the_base_class_or_with_its_defaults_is_not_adapted_again():
    walk, plain = Walk(), adapt(System, Plain())
    assert adapt(System, walk) is walk
    assert adapt(System, plain) is plain


def test_errors_name_the_class_and_all_that_it_lacks():
    with pytest.raises(
        UsageError, match="Camera is not a valid simulator: it lacks dt, reset, step, signals"
    ) as error:
        adapt(Simulator, Camera())
    assert error.value.hint == (
        "a simulator has noise_size, dt, reset(noise), step(world, action, noise) and signals(world)"
    )
    with pytest.raises(UsageError, match="Plain cannot draw from another law"):
        adapt(System, Plain()).under(None)


def test_a_class_in_place_of_a_part_is_refused():
    with pytest.raises(UsageError, match="Camera is a class, not a perception error model") as error:
        adapt(PerceptionErrorModel, Camera)
    assert error.value.hint == "give an object of it, such as Camera()"


def test_a_default_that_gives_the_part_itself_keeps_the_defaults():
    assert adapt(System, Plain()).with_weights().ended(None) is None


def test_an_adapted_part_survives_pickling():
    again = pickle.loads(pickle.dumps(adapt(System, Plain())))
    assert type(again).__name__ == "Plain"
    assert again.noise_size == 1


def test_a_wrapper_is_the_system_but_for_what_it_changes():
    class Slow(SystemWrapper):
        def signals(self, state):
            return {"x": 0.5 * super().signals(state)["x"]}

    system = Slow(Fragile("fault"))
    state = system.step(system.initial(np.zeros((2, 2))), np.array([[1.0, 9.0], [1.0, 0.0]]))
    assert system.noise_size == 2
    assert system.signals(state)["x"] == pytest.approx([0.05, 0.05])
    assert system.faults(state).tolist() == [True, False]


class Half(Plain):
    """A system whose optional property looks for what it does not have."""

    @property
    def perfect_noise(self):
        return self.calm


def test_an_attribute_error_within_a_property_is_not_taken_for_an_absent_member():
    system = adapt(System, Half())
    with pytest.raises(AttributeError, match="'Half' object has no attribute 'calm'"):
        _ = system.perfect_noise
    assert adapt(System, Plain()).perfect_noise is None

    class Unsized(Plain):
        @property
        def noise_size(self):
            return self.size

    with pytest.raises(AttributeError, match="no attribute 'size'"):
        adapt(System, Unsized())


def test_warnings_of_the_parts_are_the_loops():
    from avrare.stack.closed_loop import ClosedLoop

    class Worn(Plain):
        dt = 0.1
        warnings = {"worn_tyres": "half of the grip is left"}  # noqa: RUF012
        reset = Plain.initial

        def step(self, world, action, noise):
            return world

    class Dirty(Camera):
        warnings = {"dirt": "the lens is dirty"}  # noqa: RUF012

    assert ClosedLoop(Worn()).warnings == Worn.warnings
    assert ClosedLoop(Worn(), Dirty()).warnings == {**Worn.warnings, **Dirty.warnings}


def test_a_warning_of_a_system_can_be_suppressed():
    class Warned(Walk):
        warnings = {"worn_tyres": "half of the grip is left"}  # noqa: RUF012

    problem = avrare.Problem(Warned(), avrare.stl("always (x < 0.1)"), steps=3)
    assert avrare.estimate(problem, "mc", rollouts=20).health == Warned.warnings
    assert not avrare.estimate(problem, "mc", rollouts=20, suppress=["worn_tyres"]).health
