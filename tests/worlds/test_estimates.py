"""Estimators on worlds: the same bits for any way of copying and any number of workers."""

import json

import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.worlds import NotDeterministic, as_system, require

FORMULA = "always (x < 0.9)"
AMS = {"particles": 20, "discard": 4, "runs": 2}


def estimate(system, estimator="ams", workers=1, steps=20, **options):
    problem = avrare.Problem(system, avrare.stl(FORMULA), steps, chunk=8)
    return avrare.estimate(problem, estimator, seed=3, workers=workers, **options)


def plain(result):
    content = json.loads(result.to_json())
    content["notes"] = [note for note in content["notes"] if note["kind"] != "counts"]
    return {name: value for name, value in content.items() if name not in ("seconds", "counts")}


@pytest.mark.parametrize("copy", ["replay", "deepcopy", "hook"])
@pytest.mark.parametrize("estimator", ["mc", "ams"])
def test_the_estimate_equals_that_of_the_batched_system(toys, copy, estimator):
    options = AMS if estimator == "ams" else {"rollouts": 200}
    found = estimate(as_system(toys.Hooked, copy=copy), estimator, **options)
    expected = estimate(toys.BatchWalk(), estimator, **options)
    assert plain(found) == plain(expected)
    assert found.simulated_steps == expected.simulated_steps
    if estimator == "ams":
        assert 0.0 < found.probability < 0.2
        assert (found.counts.get("replayed_steps", 0) > 0) == (copy == "replay")


def test_other_estimators_accept_worlds(toys):
    result = estimate(as_system(toys.Walk), "ess", chains=20, runs=2)
    assert 0.0 < result.probability < 0.2


def test_a_nondeterministic_world_is_refused_by_splitting_before_anything_runs(toys):
    words = r"ams must continue rollouts from others.*signal 'x' differs from step"
    with pytest.raises(UsageError, match=words):
        estimate(as_system(toys.Careless), **AMS)
    assert estimate(as_system(toys.Careless), "mc", rollouts=20).errors == 0


def test_a_world_that_is_nondeterministic_later_is_refused_at_the_first_branch(toys):
    with pytest.raises(NotDeterministic, match=r"signal 'x' was .* no rollout can branch"):
        estimate(as_system(toys.LateCareless), **AMS)


def test_a_world_whose_reset_leaves_traces_needs_reuse_false(toys):
    with pytest.raises(UsageError, match="continue rollouts from others"):
        estimate(as_system(toys.Leaky), **AMS)
    systems = as_system(toys.Leaky, reuse=False), as_system(toys.Walk)
    found, expected = (plain(estimate(system, **AMS)) for system in systems)
    assert found == expected


@pytest.mark.parametrize(
    ("name", "reason"), [("Entangled", "signal 'x' differs"), ("Brittle", "it raises AssertionError")]
)
def test_deep_copies_that_do_not_continue_like_the_world_are_refused(toys, name, reason):
    words = f"copy of the world by deepcopy does not continue like the world.*{reason}"
    with pytest.raises(UsageError, match=words):
        estimate(as_system(getattr(toys, name), copy="deepcopy"), **AMS)
    found = plain(estimate(as_system(getattr(toys, name)), **AMS))
    assert found == plain(estimate(as_system(toys.Walk), **AMS))


def test_what_cannot_be_copied(toys):
    class Locked(toys.Walk):
        def __deepcopy__(self, memo):
            raise TypeError("no")

    with pytest.raises(UsageError, match="cannot be copied by deepcopy: TypeError: no"):
        estimate(as_system(Locked, copy="deepcopy"), **AMS)


def test_an_estimator_names_missing_capabilities_before_anything_runs(toys):
    class Sealed(toys.Walk):
        lacks = {"branches": "its maker says so"}  # noqa: RUF012

    system = as_system(Sealed)
    require(system, "mc", ())
    require(system, "is", ("noise",))
    with pytest.raises(UsageError, match=r"ams must continue rollouts from others.*its maker says so"):
        require(system, "ams", ("branches",))
    with pytest.raises(UsageError, match="ess must choose the noise"):
        require(as_system(toys.Careless), "ess", ("noise",))
    batched = avrare.Problem(toys.BatchWalk(), avrare.stl("x < 1"), steps=1).system
    require(batched, "ess", ("noise", "branches"))
