"""Annealing of the noise's scale: what counts is drawn after the scale is chosen."""

from types import SimpleNamespace

import numpy as np

from avrare.rollout.noise import NoiseSource
from avrare_estimators.common.samples.cross_check import GROUPS
from avrare_estimators.common.samples.scale_annealing import ScaleAnnealing
from avrare_estimators.common.samples.sources import Stratum


def begin(run=0):
    plan = SimpleNamespace(steps=5, noise=NoiseSource(3, 1))
    source = SimpleNamespace(target_request=lambda tapes: tapes)
    target = Stratum(plan, run, 0, 10, from_target=True)
    return ScaleAnnealing.begin(
        [SimpleNamespace(strata=(target,), violated=np.array([True]), source=source)], 12_000
    )


def tell(annealing, failed):
    return annealing.tell(SimpleNamespace(violated=failed[:, None], error=np.zeros(len(failed), dtype=bool)))


def fail_largest(annealing, share):
    """Return the next state where this share of the tapes fails, those with the largest sum."""
    sums = annealing.pending.sum(axis=(1, 2))
    return tell(annealing, sums > np.quantile(sums, 1.0 - share))


def test_rollouts_that_choose_the_scale_do_not_count():
    seeking = begin()
    larger = fail_largest(seeking, 0.01)
    assert (larger.scale, larger.counts) == (1.6, False)
    chosen = fail_largest(larger, 0.05)
    assert (chosen.scale, chosen.walkers) == (1.6, None)
    assert chosen.counts
    assert not chosen.probabilities.any()
    assert not np.isin(chosen.pending, larger.pending).any()
    walking = fail_largest(chosen, 0.04)
    assert walking.scale < 1.6
    assert np.isin(walking.walkers, chosen.pending).all()


def test_runs_choose_their_walkers_by_numbers_of_their_own(monkeypatch):
    def draw(annealing, rows):
        return np.linspace(0.0, 1.0, rows * 6).reshape(rows, 6, 1)

    def walkers(run):
        chosen = fail_largest(begin(run), 1.0)
        return fail_largest(chosen, 1.0).walkers

    monkeypatch.setattr(ScaleAnnealing, "_normals", draw)  # both runs meet the same failures
    first, second = walkers(0), walkers(1)
    assert len(first) % GROUPS == 0
    assert (first != second).any()
