"""Searches that no score leads: tail atoms beside a learned proposal, and annealing of the noise's scale."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, norm

import avrare
from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare_estimators.common.samples.cross_check import GROUPS
from avrare_estimators.common.samples.scale_annealing import ScaleAnnealing
from avrare_estimators.common.samples.sources import Stratum
from avrare_estimators.common.tapes.tail_atoms import SHARE, tail_atoms, with_tail_atoms
from avrare_estimators.common.tapes.tape_mixture import TapeMixture
from plain_systems import Static, Still

pytestmark = pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")


class Stuck(Still):
    """Drive that gets stuck by a rare fault of one step, which no signal shows beforehand."""

    noise_size, steps, rate = 2, 30, 2e-6

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "stuck": np.zeros(len(noise), bool)}

    def step(self, state, noise):
        stuck = state["stuck"] | (noise[:, 1] > norm.isf(self.rate))
        return {"x": state["x"] + np.where(stuck, 0.0, 1.0 + 0.1 * noise[:, 0]), "stuck": stuck}


def modes(visible=4.2, hidden=3e-5):
    """Return a problem of a visible mode and a hidden one, that of a norm of four numbers, and its p."""
    far = chi2.isf(hidden, 4)
    system = Static(5, lambda w: np.maximum(w[:, 0] / visible, 1.2 * ((w[:, 1:] ** 2).sum(axis=1) > far)))
    return avrare.Problem(system, avrare.stl("always (x < 1)"), 0), 1 - (1 - norm.sf(visible)) * (1 - hidden)


def draw(mixture: TapeMixture, rows: int) -> Floats:
    rng = np.random.default_rng(3)
    tapes = rng.standard_normal((rows, *mixture.shape))
    mixture.transform(tapes, mixture.choose(rng.random((rows, 3))), 0)
    return tapes


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 3), (21, 2)])
def test_tail_atoms_have_exact_weights(shape):
    rows, channels = shape
    atoms = tail_atoms(rows - 1, channels)
    tapes = draw(atoms, 40_000)
    density = np.exp(-atoms.log_ratio_of(tapes))
    weights = 1.0 / (0.5 + 0.5 * density)
    target = np.random.default_rng(4).standard_normal((40_000, *shape))
    others = 1.0 / (0.5 + 0.5 * np.exp(-atoms.log_ratio_of(target)))
    mean = (weights.mean() + others.mean()) / 2.0
    error = np.sqrt((weights.var() + others.var()) / 4.0 / 40_000)
    assert abs(mean - 1.0) < 4.0 * error


def test_every_number_of_every_step_has_its_tails():
    tapes = draw(tail_atoms(5, 2), 60_000)
    assert ((np.abs(tapes) > 4.0).mean(axis=0) > 100 * 2 * norm.sf(4.0)).all()


def test_a_learned_proposal_keeps_its_share_beside_them():
    learned = TapeMixture.freeze([(1.0, [{(0, 3, 3, 1.0, 0.0, 3.0, 1.0): 1.0}])], (6, 1))
    law = with_tail_atoms(learned)
    assert law.learned is learned
    assert law.share.sum() == pytest.approx(1.0, abs=1e-3)
    tapes = np.random.default_rng(5).standard_normal((50, 6, 1))
    parts = [np.exp(-one.log_ratio_of(tapes)) for one in (learned, tail_atoms(5, 1))]
    mixed = (1.0 - SHARE) * parts[0] + SHARE * parts[1]
    np.testing.assert_allclose(np.exp(-law.log_ratio_of(tapes)), mixed, rtol=2e-3)


@pytest.mark.slow
def test_a_hidden_fault_is_found_and_weighed():
    problem = avrare.Problem(Stuck(), avrare.stl("eventually[0:30 samples] (x >= 15)"), 30)
    truth = 1.0 - (1.0 - Stuck.rate) ** 15  # stuck before the goal
    results = [avrare.estimate(problem, "is", seed=seed) for seed in range(6)]
    mean = np.mean([result.probability for result in results])
    assert mean == pytest.approx(truth, rel=0.15)
    assert sum(low <= truth <= high for low, high in (result.interval for result in results)) >= 5


@pytest.mark.slow
def test_annealing_vouches_for_a_mode_that_no_score_shows():
    problem, truth = modes()
    results = [avrare.estimate(problem, "is", seed=seed, rollouts=60_000) for seed in range(6)]
    checks = [
        np.mean(look["probabilities"])
        for result in results
        for look in result.diagnostics["second_look"]
        if look is not None
    ]
    assert len(checks) >= 4
    assert np.mean(checks) == pytest.approx(truth, rel=0.25)
    assert np.mean([result.probability for result in results]) == pytest.approx(truth, rel=0.15)


def begin(run=0):
    plan = SimpleNamespace(steps=5, noise=NoiseSource(3, 1))
    source = SimpleNamespace(replay=lambda tapes: tapes)
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
