"""Splitting with few carries, and with none after an interruption: the same estimate, and honest books."""

from dataclasses import replace

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.base import batch
from avrare.testing import faulty_systems as systems
from avrare_estimators.ams import splitting
from avrare_estimators.ams.splitting import Splitting
from estimates import estimate_through_kills, plain

OPTIONS = {"particles": 40, "discard": 6, "runs": 2, "seed": 4}
STEPS = 20


def estimate(lives=np.inf, system=None, formula="always (x < 0.9)", chunk=25, **options):
    system = system or systems.Walk()
    counting = systems.Counting(systems.Mortal(system, lives))
    problem = avrare.Problem(counting, avrare.stl(formula), steps=STEPS, chunk=chunk)
    result = avrare.estimate(problem, "ams", **{**OPTIONS, **options})
    return result, counting.rows - odd_systems.rows_of_checks(system, STEPS, branch=True)


@pytest.fixture
def limited(monkeypatch):
    """Let the carries of so many steps of all particles be kept."""

    problem = avrare.Problem(systems.Walk(), avrare.stl("always (x < 0.9)"), steps=STEPS)
    carries = [carry for _, _, carry in problem.nominal(keep_carries=True).carries]
    row = max(sum(leaf.nbytes for leaf in batch.leaves(carry)) for carry in carries)

    def limit(steps):
        slots = OPTIONS["particles"] * OPTIONS["runs"]
        monkeypatch.setattr(splitting, "run_bytes", lambda plan, particles: 1)  # of the carries alone
        # they are there twice for a moment
        monkeypatch.setitem(OPTIONS, "memory", (2 * max(steps * row * slots, 1) + 4) / 2**20)

    return limit


@pytest.fixture
def spacings(monkeypatch):
    """Return the spacings that the requests of later stages ask for."""
    ask, seen = Splitting.ask, set()

    def watched(self, state):
        request = ask(self, state)
        if request is not None and state.stage:
            seen.add(request.every)
        return request

    monkeypatch.setattr(Splitting, "ask", watched)
    return seen


@pytest.mark.parametrize(("steps", "spacing"), [(11, 2), (6, 4), (4, 8), (3, 16), (2, 32), (0, 32)])
def test_few_carries_change_nothing_but_the_cost(limited, spacings, steps, spacing):
    whole, cheap = estimate()
    assert spacings == {1}
    limited(steps)
    spacings.clear()
    result, paid = estimate()
    assert spacings == {spacing}
    assert result.simulated_steps == paid > cheap == whole.simulated_steps
    assert plain(replace(result, simulated_steps=cheap)) == plain(whole)


@pytest.mark.parametrize("steps", [6, 2])
@pytest.mark.parametrize("formula", ["always (x < 0.9)", "eventually[3:9] (x > 0.6)"])
@pytest.mark.parametrize(
    "system", [odd_systems.Odometer(), odd_systems.NestedWalk(), systems.Fragile.with_chance(0.01)]
)
def test_chunks_do_not_matter(limited, steps, formula, system):
    limited(steps)
    whole, _ = estimate(system=system, formula=formula, chunk=4096)
    for chunk in (7, 25):
        assert plain(estimate(system=system, formula=formula, chunk=chunk)[0]) == plain(whole)


@pytest.mark.parametrize("steps", [99, 6, 2])
@pytest.mark.parametrize("system", [odd_systems.Odometer(), systems.Fragile.with_chance(0.01)])
def test_an_interrupted_run_gives_the_same_result(limited, tmp_path, steps, system):
    limited(steps)
    whole, paid = estimate(system=system)
    assert whole.simulated_steps == paid
    (result, _), kills = estimate_through_kills(lambda _: estimate(150, system, checkpoint=tmp_path / "kept"))
    assert kills > 1
    assert plain(result) == plain(whole)


def test_a_stage_lost_in_the_middle_is_run_again(limited, tmp_path):
    """Lose it: some particles have carries, and what comes after is told from the files again."""
    limited(6)
    whole, _ = estimate()
    with pytest.raises(systems.Killed):
        estimate(420, checkpoint=tmp_path / "kept")
    files = sorted((tmp_path / "kept").rglob("*.npz"))
    lost = [path for path in files if path.name.startswith("000002-")]
    assert files[-1].name > "000004"
    for path in lost:
        path.unlink()
    result, _ = estimate(checkpoint=tmp_path / "kept")
    assert plain(result) == plain(whole)
