"""A stored failure on the same scenario, on another one, with other versions."""

import re
from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.analysis.failures.failure import compute_checksums, compute_fingerprints, record_failure
from avrare.analysis.failures.stored_replays import replay_failure
from avrare.base.errors import UsageError


@pytest.fixture
def failure(linear, pushed):
    return record_failure(linear, "near", pushed)


@pytest.mark.parametrize("part", ["seed=5", "estimator.chains=7", "chunk=3"])
def test_seed_estimator_and_chunk_do_not_identify_a_failure(load, failure, part):
    found = replay_failure(load(part), failure)
    assert (found.divergence, found.changes) == (None, ())


def test_another_scenario_is_named_with_the_first_difference(load, failure):
    changed = load("simulator.initial.mean=[0.5, 0, 1, 0]")
    found = replay_failure(changed, failure)
    assert found.changes[0].startswith("simulator differs: fingerprint ")
    assert len(found.changes) == 1
    assert found.divergence.startswith("the signals differ from step 0 on: ")
    then, now = map(float, re.search(r" x (\S+) -> ([^, ]+)", found.divergence).groups())
    assert now == pytest.approx(found.rollout.signals["x"][0], rel=1e-3)
    assert then == pytest.approx(now - 0.5, rel=1e-2)


def test_the_step_is_the_first_that_differs(linear, failure):
    sums, values = failure.checksums.copy(), failure.values.copy()
    sums[7:] += 1
    found = replay_failure(linear, replace(failure, checksums=sums))
    assert found.divergence == "the signals differ from step 7 on, by less than a part in 4000"
    values[9:, failure.columns.index("y")] *= 2
    found = replay_failure(linear, replace(failure, checksums=sums, values=values))
    assert found.divergence.startswith("the signals differ from step 7 on, visibly from step 9 on: y ")
    found = replay_failure(linear, replace(failure, checksums=sums, values=values[:0]))
    assert found.divergence == "the signals differ from step 7 on"


def test_another_version_is_named(linear, failure):
    versions = {**failure.versions, "avrare": "0.0.9"}
    found = replay_failure(linear, replace(failure, versions=versions))
    assert found.changes == (f"avrare 0.0.9 -> {avrare.__version__}",)
    assert found.divergence is None


def test_the_plugin_of_another_estimator_is_not_a_difference(linear, load, failure):
    other = replace(failure, versions={**failure.versions, "avrare-other": "1.0"})
    assert replay_failure(linear, other).changes == ()
    assert "avrare-other 1.0 -> none" in replay_failure(load("simulator.dt=0.11"), other).changes


def test_the_content_of_a_file_belongs_to_its_part(linear, failure, monkeypatch):
    path = "simulator.model"
    monkeypatch.setattr(
        "avrare.analysis.failures.failure.digests", lambda _: {path: "a", "estimator.proposal": "b"}
    )
    stored = replace(failure, parts=compute_fingerprints(linear.definition, "near"))
    assert replay_failure(linear, stored).changes == ()
    monkeypatch.setattr("avrare.analysis.failures.failure.digests", lambda _: {path: "c"})
    (line,) = replay_failure(linear, stored).changes
    assert line.startswith("simulator differs: fingerprint ")


def test_noise_of_another_shape_cannot_be_replayed(load, failure):
    with pytest.raises(
        UsageError, match="21 x 6 numbers of noise, but double_integrator needs 22 x 6"
    ) as caught:
        replay_failure(load("steps=21"), failure)
    assert "steps differs" in caught.value.hint


def test_checksums_depend_on_the_last_bit_and_not_on_the_order():
    signals = {"a": np.arange(4.0), "b": np.ones((4, 2)), "c": np.array([True, False, True, True])}
    sums = compute_checksums(signals)
    assert len(set(sums.tolist())) == 4
    np.testing.assert_array_equal(sums, compute_checksums(dict(reversed(signals.items()))))
    signals["b"][2, 1] = np.nextafter(1.0, 2.0)
    assert np.flatnonzero(compute_checksums(signals) != sums).tolist() == [2]
