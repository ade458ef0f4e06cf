"""Short part of the attack (``make attack`` is the long one): the same seeds each time, in this process.

Whatever the long one finds is mended by its cause, with a test beside the code.
"""

import pytest

from attack import crash_points, kills
from attack.kinds import KINDS, attempt
from attack.material import inside

QUICK = {"scenarios": 60, "formulas": 80, "recorded drives (CSV)": 150}
"""Inputs of each kind in the default suite; they need nothing that takes long to make."""
MANY = {
    "scenarios": 200, "scenarios that run": 120, "formulas": 200, "rules files": 40,
    "recorded drives (CSV)": 300, "recorded drives (CommonRoad)": 60, "run folders": 100, "checkpoints": 30,
    "baselines": 50, "stored failures": 120, "failures as text": 100,
    "models, policies and flows": 80, "catalogues, searches and what was learned": 60, "command lines": 120,
    "OpenSCENARIO files": 40, "twins, ensembles, functions and syntheses": 40,
    "tables to fit, and policies to convert": 50,
}  # fmt: skip


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    with inside(tmp_path_factory.mktemp("attack")) as folder:
        yield folder


def strike(name, seeds, home):
    found = {seed: answer for seed in seeds if (answer := attempt(name, seed, home))[0]}
    assert not found, "\n\n".join(
        f"{name}, seed {seed}: {one}\n{told}" for seed, (one, told) in found.items()
    )


@pytest.mark.parametrize("name", QUICK)
def test_no_input_ends_in_a_traceback_a_hang_or_a_wrong_exit_code(name, home):
    strike(name, range(QUICK[name]), home)


@pytest.mark.slow
@pytest.mark.parametrize("name", MANY)
def test_no_input_does_and_there_are_many(name, home):
    strike(name, range(QUICK.get(name, 0), MANY[name]), home)


def test_every_kind_is_tried():
    assert set(KINDS) == set(MANY)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_runs_that_are_killed_end_with_the_same_bits(seed, home):
    found, told, _ = kills.harass(seed, home)
    assert not found, f"{found}\n{told}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["report", "failures add"])
def test_a_command_that_is_killed_at_any_call_can_be_repeated(name, home):
    found = [answer for answer in crash_points.points(crash_points.TASKS[name], home) if answer[1]]
    assert found == []
