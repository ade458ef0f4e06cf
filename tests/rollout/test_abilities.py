"""Optional abilities are members; None stands for an absent one, and wrappers may forward them."""

import numpy as np

import avrare
from avrare.protocols import (
    CountsEvents,
    HasScene,
    ReportsFaults,
    find_ability,
    find_notes,
    forward_abilities,
)
from avrare.testing.faulty_systems import Walk


class Part:
    """A part that breaks down and has no scene."""

    scene = None

    def faults(self, state):
        return np.ones(len(state), dtype=bool)


class Wrapper:
    """A wrapper that forwards every member."""

    def __init__(self, part):
        self.part = part

    def __getattr__(self, name):
        return getattr(self.part, name)


def test_a_member_is_an_ability():
    part = Part()
    assert find_ability(part, ReportsFaults) is part
    assert find_ability(part, CountsEvents) is None


def test_a_member_that_is_none_counts_as_absent():
    assert find_ability(Part(), HasScene) is None
    assert find_ability(None, HasScene) is None


def test_a_wrapper_has_the_abilities_that_it_forwards():
    wrapper = Wrapper(Part())
    assert find_ability(wrapper, ReportsFaults) is wrapper


def test_forwarded_members_are_attributes():
    class Plain:
        pass

    wrapper = Plain()
    forward_abilities(wrapper, Part(), ReportsFaults, CountsEvents)
    assert wrapper.faults([0, 1]).all()
    assert not hasattr(wrapper, "counts")


def test_notes_are_those_of_the_simulator():
    class Simulator:
        notes = {"model_error": "the law is fitted"}  # noqa: RUF012

    class Loop:
        simulator = Simulator()

    assert find_notes(Loop()) == find_notes(Simulator()) == {"model_error": "the law is fitted"}
    assert find_notes(Part()) == {}


def test_a_note_of_a_system_can_be_suppressed():
    class Noted(Walk):
        notes = {"worn_tyres": "half of the grip is left"}  # noqa: RUF012

    problem = avrare.Problem(Noted(), avrare.stl("always (x < 0.1)"), steps=3)
    assert avrare.estimate(problem, "mc", rollouts=20).health == Noted.notes
    assert not avrare.estimate(problem, "mc", rollouts=20, suppress=["worn_tyres"]).health
