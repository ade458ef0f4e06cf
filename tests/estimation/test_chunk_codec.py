"""Outcomes as bytes: the same come back, or none."""

import io
from dataclasses import replace

import numpy as np
import pytest

import damage
from avrare.base.errors import UsageError
from avrare.estimation.loop.checkpoint import FileJournal, decode, digest, encode
from avrare.rollout.request import Request, Rollouts

OUTCOME = Rollouts(
    robustness=np.array([[0.5, -np.inf], [np.nan, 3e-320]]),
    violated=np.array([[False, True], [True, False]]),
    error=np.array([False, True]),
    scores=np.array([[-np.inf, 0.1, 0.3], [-0.0, 0.0, np.nextafter(1.0, 2.0)]]),
    simulated_steps=4,
    counts={"solves": np.array([3, 0]), "key": np.array([1, 2])},
    messages=("ValueError: λ < 0", ""),
    log_weight=np.array([0.0, -1.5]),
    every=4,
)
FIELDS = ("robustness", "violated", "error", "scores", "log_weight")


def same(one, two):
    for name in FIELDS:
        a, b = getattr(one, name), getattr(two, name)
        if (a.dtype, a.shape, a.tobytes()) != (b.dtype, b.shape, b.tobytes()):
            return False
    plain = [
        (r.simulated_steps, r.every, r.messages, {name: v.tolist() for name, v in r.counts.items()})
        for r in (one, two)
    ]
    return plain[0] == plain[1]


def request(rows=3, **changes):
    index = np.arange(rows)
    parts = {"run": index * 0, "stage": index * 0, "particle": index, "start": index * 0 - 1, **changes}
    return Request(**parts)


def test_the_same_bits_come_back():
    outcome, seconds, key = decode(encode(OUTCOME, "key", 1.25))
    assert same(outcome, OUTCOME)
    assert (seconds, key) == (1.25, "key")


def test_an_outcome_without_messages_counts_and_scores():
    bare = Rollouts(*(np.zeros((2, 1)), np.zeros((2, 1), bool), np.zeros(2, bool), np.zeros((2, 0)), 0))
    outcome, *_ = decode(encode(bare, "", 0.0))
    assert same(outcome, bare)


def test_features_that_no_row_lived_to_show_come_back():
    observed = replace(OUTCOME, features=np.zeros((2, 1, 0)))
    outcome, *_ = decode(encode(observed, "key", 0.0))
    assert outcome.features.shape == (2, 1, 0)


@pytest.mark.slow
def test_a_wrong_byte_never_gives_a_wrong_outcome():
    content = encode(OUTCOME, "key", 1.25)
    refused = 0
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 0x10
        try:
            outcome, *_ = decode(bytes(damaged))
        except ValueError:
            refused += 1
        else:
            assert same(outcome, OUTCOME), place
    assert refused > len(content) / 2


@pytest.mark.parametrize("many", [0, 1, 100, -1])
def test_a_truncated_chunk_is_refused(many):
    content = encode(OUTCOME, "key", 1.25)
    with pytest.raises(ValueError, match="damaged"):
        decode(content[:many])


def test_the_chunk_of_another_request_or_estimate_is_refused(tmp_path):
    journal = FileJournal(tmp_path, "owner")
    journal.write(0, 0, request(2), OUTCOME, 1.25)
    (stored,) = journal.read(0, request(2))
    assert same(stored.outcome, OUTCOME)
    others = request(1), request(particle=np.arange(1, 4))
    for owner, asked in [("other", request(2)), *(("owner", other) for other in others)]:
        with pytest.raises(UsageError, match="another estimate"):
            list(FileJournal(tmp_path, owner).read(0, asked))


def test_the_digest_distinguishes_requests():
    tape = np.zeros((3, 2, 1))
    others = [
        request(), request(2), request(run=np.ones(3, int)), request(stage=np.ones(3, int)),
        request(particle=np.arange(1, 4)), request(start=np.zeros(3, int)), request(stop_early=True),
        request(tape=tape), request(tape=tape + 1e-300), request(law="a law"),
    ]  # fmt: skip
    lineages = [np.array([[0], [1], [1]]), np.array([[0], [1], [2]]), np.array([[0, 0], [1, 1], [1, 2]])]
    others += [request(lineage=lineage.astype(np.int32)) for lineage in lineages]
    assert len({digest(one) for one in others}) == len(others)
    assert digest(request()) == digest(request())
    whole = request(lineage=lineages[1].astype(np.int32))
    assert digest(whole.slice(0, 2)) == digest(request(2, lineage=whole.lineage[:2]))


def refused(content):
    try:
        decode(content)
    except ValueError as error:
        return "damaged" in str(error)
    return False


def test_arrays_of_another_shape_type_or_value_are_refused():
    """Write the file anew with one array changed, so that its checksums fit."""
    content, random = encode(OUTCOME, "key", 1.25), np.random.default_rng(25)
    for seed in range(300):
        changed = damage.damage_arrays(content, random)
        try:
            outcome, seconds, _ = decode(changed)
        except ValueError:
            continue
        assert same(outcome, OUTCOME), seed
        assert seconds == 1.25, seed


def test_a_changed_number_is_refused_though_all_types_fit():
    with np.load(io.BytesIO(encode(OUTCOME, "key", 1.25))) as file:
        arrays = dict(file)
    arrays["robustness"] = arrays["robustness"] + 1e-9
    changed, unsealed = io.BytesIO(), io.BytesIO()
    np.savez(changed, **arrays)
    del arrays["checksum"]
    np.savez(unsealed, **arrays)
    assert refused(changed.getvalue())
    assert refused(unsealed.getvalue())
