"""Proposals learnt on the noise tape: what they find, what they say, and the same bits."""

import json
from functools import partial

import numpy as np
import pytest
from outlier_systems import STEPS, Outliers, outliers, peak, wide
from scipy.stats import beta

import avrare
from avrare.base.errors import UsageError
from avrare.testing.problems import reference_problem
from avrare_estimators.common.learning.dictionary import entries_of_channel, fit
from avrare_estimators.common.tapes.tape_mixture import TapeMixture
from avrare_estimators.importance.config import IsConfig
from estimates import estimate_through_kills, plain


def test_chance_of_entries_is_that_of_target_rows():
    table = entries_of_channel(STEPS)
    tapes = np.random.default_rng(5).standard_normal((3000, STEPS + 1, 2))
    ratios = table.ratios(tapes, 1)
    z = (ratios / (1.0 + ratios)).mean(axis=0) - table.mean
    assert np.abs(z / (table.deviation * np.sqrt(1 / 3000 + 1 / 4000))).max() < 5.0


def test_fit_finds_the_channel_and_the_step():
    tapes = np.random.default_rng(2).standard_normal((100, 21, 6))
    tapes[:, 7, 4] = 3.5 * np.sign(tapes[:, 7, 4])
    mixture = fit(tapes, np.ones(100), 0.25)
    place = {row[:3]: 0.0 for row in mixture.atoms.rows}
    for share, groups in mixture.components:
        for row, part in groups[0].items():
            place[row[:3]] += share * part
    best = max(place, key=place.get)
    assert best == (4, 7, 7)
    assert sum(share for (channel, *_), share in place.items() if channel == 4) > 0.8


def test_fit_pairs_outliers_of_two_channels():
    rng, rows = np.random.default_rng(3), np.arange(120)
    tapes = rng.standard_normal((120, 21, 6))
    first, second = rng.integers(3, 7, 120), rng.integers(10, 14, 120)
    for channel, step in ((1, first), (4, second)):
        tapes[rows, step, channel] = 3.5 * np.sign(tapes[rows, step, channel])
    mixture = fit(tapes, np.ones(120), 0.25)
    paired = [
        share
        for share, groups in mixture.components
        if [int(next(iter(group))[0]) for group in groups] in ([1, 4], [4, 1])
    ]
    assert sum(paired) > 0.5 * sum(share for share, _ in mixture.components)


def estimate(problem, seed=0, **options):
    return avrare.estimate(problem, "is", seed=seed, **{"rollouts": 6000, "pilot": 900, **options})


@pytest.fixture(scope="module")
def one_outlier():
    return estimate(outliers("always (first < 4)"))


def test_an_outlier_is_found(one_outlier):
    exact = peak(4.0)
    assert one_outlier.interval[0] <= exact <= one_outlier.interval[1]
    file = one_outlier.artifacts["learned.json"]
    share = {"gust": 0.0}
    for component in file["components"]:
        noise = file["atoms"][file["groups"][component["groups"][0]]["atoms"][0]]["noise"]
        share[noise] = share.get(noise, 0.0) + component["share"]
    assert share["gust"] > 0.5
    spent = one_outlier.diagnostics
    assert one_outlier.rollouts == spent["learning_rollouts"] + sum(spent["rows"]) + spent["check_rollouts"]
    # Monte Carlo would have needed (1 - p) / p over the squared relative error.
    assert one_outlier.relative_error**2 * one_outlier.rollouts < 0.2 / exact


def test_the_file_saves_the_pilot(one_outlier, tmp_path):
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"specification": one_outlier.artifacts["learned.json"]}))
    again = estimate(outliers("always (first < 4)"), seed=1, learned=str(path), rollouts=3000)
    assert again.diagnostics["learning_rollouts"] == 0
    assert again.diagnostics["proposal"] == one_outlier.diagnostics["proposal"]
    assert again.interval[0] <= peak(4.0) <= again.interval[1]
    assert again.relative_error < 0.15


def test_no_structure_falls_back_to_monte_carlo():
    exact = -np.expm1(STEPS * np.log1p(-2.5e-4))
    result = estimate(outliers("always (digits < 0.99975)"), stages=3)
    assert "drawn from the target" in {note.kind: note.text for note in result.notes}["learning"]
    assert result.artifacts == {}
    assert result.health == {}
    assert result.interval[0] <= exact <= result.interval[1]
    rows, failures = result.diagnostics["rows"][0], round(result.probability * result.diagnostics["rows"][0])
    assert failures > 0
    assert np.isclose(result.interval[0], beta.ppf(0.025, failures, rows - failures + 1))


def test_an_error_that_lasts_is_drawn_along_its_own_direction():
    tapes = np.random.default_rng(4).standard_normal((400, 31, 3))
    v = np.r_[np.sqrt(0.3), np.sqrt(0.7 * 0.36) * 0.8 ** np.arange(19, -1, -1), np.zeros(10)]
    v /= np.linalg.norm(v)
    along = tapes[:, :, 1] @ v
    tapes[:, :, 1] += (3.2 * np.where(along > 0, 1.0, -1.0) - 0.3 * along)[:, None] * v
    mixture = fit(tapes[:200], np.ones(200), 0.25)
    gained = np.log(0.25 + 0.75 * np.exp(-mixture.log_ratio_of(tapes[200:])))
    single = TapeMixture.freeze([(1.0, [{wide(1, t): 1.0}]) for t in range(31)], (31, 3))
    assert gained.mean() > 2.0  # of the 4.4 nats of drawing exactly these
    assert gained.mean() > np.log(0.25 + 0.75 * np.exp(-single.log_ratio_of(tapes[200:]))).mean() + 1.5
    shared = sum(
        share for share, (group, *_) in mixture.components if all(row[0] == 1 and row[4] > 0 for row in group)
    )
    assert shared > 0.5


@pytest.mark.slow
def test_lasting_noise_pays():
    result = estimate(outliers("always (drift < 4.0)"), rollouts=9000)
    counted = result.diagnostics["rows"][0]
    assert result.relative_error**2 * counted < 0.2 / result.probability


def test_a_mode_that_the_file_lacks_is_found_by_tail_atoms(tmp_path):
    lacking = TapeMixture.freeze([(1.0, [{wide(0, t): 1.0}]) for t in range(1, STEPS + 1)], (STEPS + 1, 3))
    path = tmp_path / "learned.json"
    path.write_text(json.dumps({"specification": lacking.to_dict()}))
    exact = peak(4.2) + (1.0 - peak(4.2)) * peak(3.6)
    problem = outliers("always (first < 4.2 and second < 3.6)")
    results = [estimate(problem, seed, learned=str(path), rollouts=8000) for seed in range(4)]
    assert all(result.interval[0] <= exact <= result.interval[1] for result in results)
    assert np.mean([result.probability for result in results]) == pytest.approx(exact, rel=0.2)


def test_options_that_do_not_fit():
    problem = outliers("always (first < 4)")
    with pytest.raises(UsageError, match=r"at least 0\.25"):
        estimate(problem, defensive=0.1)
    with pytest.raises(UsageError, match="leave runs at 1"):
        estimate(problem, relative_error=0.1, runs=2)
    with pytest.raises(UsageError, match="belongs to `proposal: learned`"):
        avrare.estimate(problem, "is", proposal={"name": "gaussian"}, stages=3)


@pytest.mark.slow
def test_same_bits_for_workers_chunks_and_after_a_stop(one_outlier, tmp_path):
    assert plain(estimate(outliers("always (first < 4)", chunk=97))) == plain(one_outlier)
    assert plain(estimate(outliers("always (first < 4)"), workers=2)) == plain(one_outlier)
    whole = plain(estimate(outliers("always (first < 4)", chunk=500)))
    mortal = partial(outliers, "always (first < 4)", chunk=500)
    result, kills = estimate_through_kills(
        lambda kills: estimate(mortal(lives=60 + 60 * kills), checkpoint=tmp_path / "kept")
    )
    assert kills > 0
    assert plain(result) == whole


@pytest.mark.slow
def test_unbiased_and_honest_over_seeds():
    exact = reference_problem("e_ou_L4.0")
    results = [estimate(exact.problem(), seed, rollouts=6000, pilot=1000) for seed in range(6)]
    values = np.array([result.probability for result in results]) / exact.probability
    assert abs(values.mean() - 1.0) < 4.0 * values.std(ddof=1) / np.sqrt(len(values))
    assert values.std(ddof=1) < 0.2
    covers = [one.interval[0] <= exact.probability <= one.interval[1] for one in results]
    assert np.mean(covers) > 0.95 - 4.0 * np.sqrt(0.05 * 0.95 / len(results))


@pytest.mark.slow
def test_stops_at_a_relative_error():
    exact = reference_problem("d_rw_L3.8")
    result = estimate(exact.problem(), relative_error=0.2, rollouts=40_000)
    assert result.relative_error <= 0.2
    assert result.diagnostics["goal_reached"]
    assert result.rollouts < 20_000
    assert result.interval[0] <= exact.probability <= result.interval[1]


def test_all_options_of_a_given_proposal_are_read_again():
    """Read them from the scenario.yaml of a run folder, from which a run resumes."""
    given = IsConfig(proposal={"name": "gaussian", "mean": 0.3})
    again = IsConfig.model_validate(given.model_dump())
    assert again.model_dump() == given.model_dump()
    assert (again.most_rollouts, again.target_share) == (given.most_rollouts, given.target_share)
    with pytest.raises(ValueError, match="stages belongs to"):
        IsConfig(proposal={"name": "gaussian", "mean": 0.3}, stages=3)


def test_where_each_of_a_few_rollouts_breaks_down_the_errors_are_counted():
    class Broken(Outliers):
        def signals(self, state):
            return {"first": np.full_like(state.first, np.nan)}

    task = avrare.Problem(Broken(), avrare.stl("always (first < 2)"), STEPS)
    with pytest.warns(avrare.base.errors.HealthWarning):
        result = avrare.estimate(task, "is", rollouts=150)
    assert (result.probability, result.errors) == (0.0, result.rollouts)
    assert "errors" in result.health
    assert result.interval == pytest.approx((0.0, 1.0))
