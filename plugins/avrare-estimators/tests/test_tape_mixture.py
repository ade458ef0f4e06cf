"""Mixtures on the noise tape: their density, their draws and their files."""

import json

import numpy as np
import pytest
from outlier_systems import STEPS, outliers, wide
from scipy.stats import multivariate_normal, norm

import avrare
from avrare.base.errors import UsageError
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import CHOICES, Request
from avrare_estimators.common.tapes.tape_mixture import TapeMixture, blend
from avrare_estimators.importance.proposal_file import ProposalFile, to_entry

GROUP = {wide(1, t): 1.0 / 3.0 for t in (1, 2, 3)}
PAIRED = TapeMixture.freeze(
    [
        (0.3, [{wide(0, 4): 1.0}]),
        (0.2, [{(2, 1, 4, 1.0, 0.0, 1.6, 1.0): 1.0}]),
        (0.1, [{(2, 1, 5, 0.5, 0.0, -1.5, 1.5): 0.6, (2, 2, 7, 0.8, 0.3, 0.0, 2.0): 0.4}]),
        (0.4, [{wide(0, 2): 0.25, wide(0, 6): 0.75}, GROUP]),
    ],
    (STEPS + 1, 3),
)


def direction(first, last, decay, start):
    found = np.zeros(STEPS + 1)
    found[int(first) : int(last) + 1] = decay ** np.arange(last - first, -1.0, -1.0)
    found *= np.sqrt(1.0 - start) / np.linalg.norm(found)
    found[0] += np.sqrt(start)
    return found


def written_out(components, tapes):
    """Return the density ratio q/p of the first steps, one normal law after the other."""
    total, steps = np.zeros(len(tapes)), tapes.shape[1]
    for share, groups in components:
        factor = np.ones(len(tapes))
        for group in groups:
            inside = np.zeros(len(tapes))
            for (channel, first, last, decay, start, shift, scale), part in group.items():
                v = direction(first, last, decay, start)[:steps]
                own = multivariate_normal(shift * v, np.eye(steps) + (scale**2 - 1.0) * np.outer(v, v))
                x = tapes[:, :, int(channel)]
                inside += part / sum(group.values()) * own.pdf(x) / norm.pdf(x).prod(axis=1)
            factor *= inside
        total += share / sum(one for one, _ in components) * factor
    return total


def drawn(mixture, rows, seed=0, chunk=None):
    """Return tapes of the mixture and log p/q, as the engine makes and weighs them."""
    noise = NoiseSource(seed, 3)
    index = np.arange(rows)
    request = Request(0 * index, 0 * index, index, 0 * index - 1, tape_law=mixture)
    problem = outliers("always (first < 4)")
    size = chunk or rows
    parts = [problem.simulate(noise, request.slice(k, k + size)) for k in range(0, rows, size)]
    tapes = noise.normals(0, 0, index[:, None], np.arange(STEPS + 1))
    mixture.transform(tapes, mixture.choose(noise.choices(0, 0, index, CHOICES)), 0)
    return tapes, np.concatenate([part.log_weight for part in parts]), parts


def test_density_is_that_of_the_law_drawn_from():
    tapes, log_weight, _ = drawn(PAIRED, 4000)
    assert np.allclose(np.exp(-log_weight), written_out(PAIRED.components, tapes), rtol=1e-9)
    # 1. Half of the rows from the target, half from the mixture: bounded weights of mean 1.
    both = np.concatenate([tapes, np.random.default_rng(1).standard_normal(tapes.shape)])
    weights = 2.0 / (1.0 + written_out(PAIRED.components, both))
    assert abs(weights.mean() - 1.0) < 4.0 * weights.std() / np.sqrt(len(weights))
    # 2. Its draws hit two channels at once as often as the law says.
    hit = (np.abs(tapes[:, 6, 0]) > 2.0) & (np.abs(tapes[:, 1:4, 1]).max(axis=1) > 2.5)
    wide_tail, tail = 2.0 * norm.sf(2.0 / 2.5), 2.0 * norm.sf(2.0)
    one = 1.0 - (1.0 - 2.0 * norm.sf(2.5)) ** 3
    grown = 1.0 - (1.0 - 2.0 * norm.sf(1.0)) * (1.0 - 2.0 * norm.sf(2.5)) ** 2
    exact = 0.4 * (0.75 * wide_tail + 0.25 * tail) * grown + 0.6 * tail * one
    assert abs(hit.mean() - exact) < 4.0 * np.sqrt(exact / len(hit))


def test_a_group_by_itself_is_the_mixture_of_its_atoms():
    """Two groups share an atom; a pair keeps its groups."""
    components = [
        (0.5, [GROUP]),
        (0.3, [{wide(1, 3): 0.5, wide(1, 4): 0.5}]),
        (0.2, [{wide(0, 2): 1.0}, GROUP]),
    ]
    mixture = TapeMixture.freeze(components, (STEPS + 1, 3))
    tapes = np.random.default_rng(4).standard_normal((50, STEPS + 1, 3)) * 1.5
    assert len(mixture.components) == 4 + 1
    np.testing.assert_allclose(
        np.exp(-mixture.log_ratio_of(tapes)), written_out(components, tapes), rtol=1e-5
    )


def test_no_bit_depends_on_the_chunk():
    _, whole, parts = drawn(PAIRED, 300)
    _, pieces, _ = drawn(PAIRED, 300, chunk=7)
    assert np.array_equal(whole, pieces)
    assert parts[0].log_weight.shape == (300,)


def test_frozen_mixtures_survive_their_file(tmp_path):
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"specification": to_entry(PAIRED, ("a", "b", "c"))}))
    read = ProposalFile.read(path).mixtures["specification"]
    assert read.digest == PAIRED.digest
    tapes = np.random.default_rng(0).standard_normal((20, STEPS + 1, 3))
    assert np.array_equal(read.log_ratio_of(tapes), PAIRED.log_ratio_of(tapes))
    both = blend([PAIRED, read], [0.5, 0.5])
    assert np.allclose(both.log_ratio_of(tapes), PAIRED.log_ratio_of(tapes), rtol=1e-4)


@pytest.mark.parametrize(
    "damage",
    [
        lambda c: c.pop("atoms"),
        lambda c: c["atoms"][0].update(channel=3),
        lambda c: c["atoms"][0].update(scale=-1.0),
        lambda c: c["components"][0].update(groups=[99]),
        lambda c: c["components"][0].update(share="much"),
        lambda c: c["components"][0].update(share=float("inf")),
        lambda c: c["groups"][0].update(shares=[[]] * len(c["groups"][0]["shares"])),
        lambda c: c["groups"][0].update(shares=[[1.0, 2.0]] * len(c["groups"][0]["shares"])),
        lambda c: c["atoms"][0].update(channel=float("inf")),
        lambda c: c.update(steps=float("inf")),
        lambda c: c.update(digest="0" * 16),
        lambda c: c["components"][3].update(groups=[0, 0]),
    ],
)
def test_damaged_files_are_told(tmp_path, damage):
    content = json.loads(json.dumps(PAIRED.to_dict()))
    damage(content)
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"specification": content}))
    with pytest.raises(UsageError, match="damaged"):
        avrare.estimate(outliers("always (first < 4)"), "is", learned=str(path))


def test_files_must_fit(tmp_path):
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"other": PAIRED.to_dict()}))
    with pytest.raises(UsageError, match="no proposal for specification, but for other"):
        avrare.estimate(outliers("always (first < 4)"), "is", learned=str(path))
    path.write_text(json.dumps({"specification": PAIRED.to_dict()}))
    with pytest.raises(UsageError, match="8 steps of 3 numbers, but a rollout has 9 steps"):
        avrare.estimate(outliers("always (first < 4)", steps=9), "is", learned=str(path))
    with pytest.raises(UsageError, match="no such file"):
        avrare.estimate(outliers("always (first < 4)"), "is", learned=str(tmp_path / "none.json"))
