"""Stages of a learned proposal that count: their shares, what they say, and the fit between them."""

from types import SimpleNamespace

import numpy as np
import pytest
from outlier_systems import outliers

import avrare
from avrare_estimators.common.lessons import dictionary
from avrare_estimators.common.lessons.lessons import Lessons
from avrare_estimators.common.samples.result import RunOutcome, _pooled_quality
from avrare_estimators.common.samples.sampling import Sample
from avrare_estimators.common.samples.sources import Stratum, TapeSource
from avrare_estimators.common.samples.stages import has_reached, is_worthless
from avrare_estimators.importance import learned_sampling
from avrare_estimators.importance.config import IsConfig
from avrare_estimators.importance.learned_sampling import LearnedSampling, relative_error


def test_a_gain_that_no_failure_shows_is_worth_nothing():
    stage = {"gain": 8.0, "gain_shown": None}
    assert not is_worthless(stage)
    assert not is_worthless({**stage, "gain_shown": 1.5})
    assert is_worthless({**stage, "gain_shown": 1.1})
    assert is_worthless({**stage, "gain": 1.9})


def made_sample(violated, log_ratio, target_rows, error=None):
    plan, n = None, len(violated)
    strata = tuple(
        Stratum(plan, 0, 0, rows, target) for rows, target in ((target_rows, True), (n - target_rows, False))
    )
    zeros, error = np.zeros(n), np.zeros(n, dtype=bool) if error is None else error
    return Sample(TapeSource(None), strata, np.array(log_ratio), np.array(violated), error, zeros, zeros, ())


def made_run():
    """Return a run whose final sample and two stages have the shares 0.5, 0.2 and 0.3, and its samples."""
    rng = np.random.default_rng(3)
    samples = [
        made_sample(rng.random(n) < 0.5, rng.normal(size=n), n // 4, rng.random(n) < 0.1)
        for n in (40, 80, 20)
    ]
    final, *stages = samples
    return RunOutcome(final, False, None, (), {}, ((0.2, stages[0]), (0.3, stages[1]))), samples


def test_an_estimate_is_the_sum_of_its_samples_by_their_shares():
    run, samples = made_run()
    shares, means, variances = (0.5, 0.2, 0.3), [], []
    for sample in samples:
        n, target = len(sample.violated), sample.target_rows
        weight = 1.0 / (0.25 + 0.75 * np.exp(-sample.log_ratio)) * sample.violated
        means.append(weight.mean())
        own, other = weight[:target], weight[target:]
        variances.append((len(own) * own.var(ddof=1) + len(other) * other.var(ddof=1)) / n**2)
    assert run.probability == pytest.approx(np.dot(shares, means))
    assert run.variance(2.0) == pytest.approx(np.dot(np.square(shares), variances) / 4.0)
    error = np.sqrt(np.dot(np.square(shares), variances)) / np.dot(shares, means)
    assert relative_error(run.parts) == pytest.approx(error)


def test_the_doubts_about_an_estimate_are_those_of_all_its_samples():
    run, samples = made_run()
    terms, broken = [], 0.0
    for share, sample in zip((0.5, 0.2, 0.3), samples, strict=True):
        weight = share / len(sample.error) / (0.25 + 0.75 * np.exp(-sample.log_ratio))
        terms.append(weight * sample.violated)
        broken += float((weight * sample.error).sum())
    terms = np.concatenate(terms)
    assert run.error_weight == pytest.approx(broken)
    marks = _pooled_quality([run])
    assert marks.effective_failures == pytest.approx(terms.sum() ** 2 / (terms**2).sum())
    assert marks.largest_share == pytest.approx(terms.max() / terms.sum())


def test_the_variance_that_a_sample_shows_is_that_of_one_of_its_rows():
    rng = np.random.default_rng(4)
    sample = made_sample(rng.random(4000) < 0.3, rng.normal(size=4000), 1000)
    weight = 1.0 / (0.25 + 0.75 * np.exp(-sample.log_ratio)) * sample.violated
    parts = 0.25 * weight[:1000].var(ddof=1) + 0.75 * weight[1000:].var(ddof=1)
    assert Lessons(0.25, (sample,)).shown_variance == pytest.approx(parts / weight.mean() ** 2)
    few = made_sample(np.arange(4000) < 9, np.zeros(4000), 1000)
    assert Lessons(0.25, (few,)).shown_variance is None


def share_of(rows, variance, goal=0.1, gain=4.0, shares=(0.0, 0.0), drawn=4000, rollouts=100_000, floor=None):
    """Return the share of a stage after a pilot and another one, which leaves ``floor`` in the variance."""
    before = made_sample(np.arange(400) % 2 == 0, np.zeros(400), 100)
    if floor is None:  # what is expected of a stage
        floor = sum(shares) * (goal or 0.1) ** 2 or 1.0
    unit = np.sqrt(learned_sampling.variance_of_sum([(shares[-1], before)], 1.0) / floor)
    state = SimpleNamespace(
        stages=[{"gain_shown": gain}],
        lessons=SimpleNamespace(shown_variance=variance, probability=unit),
        shares=shares,
        left=1.0 - sum(shares),
        rows=drawn,
        rollouts=rollouts,
        samples=(before, before),
    )
    return LearnedSampling(IsConfig(relative_error=goal, check=0.2))._share(state, rows)


def test_a_stage_has_the_share_of_its_rows_in_all_that_are_missing():
    assert share_of(1500, 100.0) == pytest.approx(1500 / (100.0 / 0.1**2))
    # What is left takes fewer rows, but for a smaller share.
    assert share_of(1500, 100.0, shares=(0.0, 0.2)) == pytest.approx(0.8 * 1500 / (0.8 * 100.0 / 0.1**2))
    assert share_of(1500, 100.0, goal=None, shares=(0.0, 0.2)) == pytest.approx(0.8 * 1500 / 76_000)
    assert share_of(1500, 100.0, shares=(0.0, 0.45)) == pytest.approx(0.05)  # half in all at most
    # Without a goal, and with one that is too dear, all that may be drawn is missing: 80 % less 4,000 rows.
    assert share_of(1500, 100.0, goal=None) == pytest.approx(1500 / 76_000)
    assert share_of(1500, 1e5) == pytest.approx(1500 / 76_000)
    # Nearly done: the final sample keeps half.
    assert share_of(1500, 1.0) == pytest.approx(0.5)
    assert share_of(1500, 1.0, shares=(0.0, 0.5)) == 0.0


def test_stages_of_a_large_variance_leave_more_rows_to_draw():
    # What is left, 0.8, must have a variance of goal squared less the floor.
    rows = 0.8**2 * 100.0 / (0.1**2 - 0.006)
    assert share_of(1500, 100.0, shares=(0.0, 0.2), floor=0.006) == pytest.approx(0.8 * 1500 / rows)
    # Near the floor and below it the goal is out of reach: a fourth of the floor is what is added to it.
    for floor in (0.009, 0.02):
        rows = 0.8**2 * 100.0 / (0.25 * floor)
        assert share_of(1500, 100.0, shares=(0.0, 0.2), floor=floor) == pytest.approx(0.8 * 1500 / rows)


def test_a_goal_that_the_stages_leave_out_of_reach_ends_the_run(monkeypatch):
    def share(self, state, rows):
        return 0.9 if len(state.shares) == 2 else 0.0

    monkeypatch.setattr(LearnedSampling, "_share", share)
    options = {"seed": 1, "rollouts": 200_000, "pilot": 3000, "relative_error": 0.02}
    result = avrare.estimate(outliers("always (first < 4)"), "is", **options)
    text = {note.kind: note.text for note in result.notes}["goal"]
    assert "before it reached" in text
    assert "learned.json" in text
    assert "raise `rollouts`" not in text
    assert result.rollouts < 50_000
    assert result.diagnostics["shares"] == [[0.1, 0.9]]
    assert result.relative_error > 0.02


def test_a_stage_after_one_that_shows_no_gain_has_no_share():
    assert share_of(1500, 100.0, gain=1.9) == 0.0
    assert share_of(1500, None, gain=None) == 0.0


def test_learning_ends_where_an_estimate_is_nearly_done():
    def ends(variance, goal=0.1, reached=True):
        stage = {"rollouts": 3000, "reached": reached, "relative_variance": 9.0, "gain": 5.0}
        state = SimpleNamespace(
            stages=[stage],
            left=1.0,
            rows=4000,
            rollouts=100_000,
            shares=(0.0,),
            samples=(None,),
            lessons=SimpleNamespace(shown_variance=variance, elite=[np.arange(99)], mixtures=(None,)),
        )
        return LearnedSampling(IsConfig(relative_error=goal, pilot=3000))._learnt(state)

    assert ends(29.0)  # 2,900 rows are missing, fewer than two stages of 1,500
    assert not ends(31.0)
    assert not ends(29.0, reached=False)
    assert not ends(29.0, goal=None)
    assert not ends(None)


def test_learning_that_counts_does_not_give_up(monkeypatch):
    monkeypatch.setattr(learned_sampling, "is_worthless", lambda stage: True)
    problem, told = outliers("always (first < 4)"), []
    given = relative_error

    def watched(parts):
        told.append([share for share, _ in parts])
        return given(parts)

    monkeypatch.setattr(learned_sampling, "relative_error", watched)
    result = avrare.estimate(
        problem, "is", seed=1, rollouts=30_000, pilot=3000, fall_back=False, relative_error=0.05
    )
    (shares,) = result.diagnostics["shares"]
    assert "proposal" in result.diagnostics
    assert told[-1] == pytest.approx(shares, abs=1e-4)  # the look is at the estimate, stages included


def test_learning_knows_failures_where_enough_are_among_its_elite():
    assert has_reached({"reached": True})
    assert has_reached({"reached": False, "failures_effective": 41.0})
    assert not has_reached({"reached": False, "failures_effective": 39.0})
    assert not has_reached({"reached": False})


def made_ratios():
    rng = np.random.default_rng(5)
    ratios = np.exp(rng.normal(0.0, 1.5, (60, 8)))
    ratios[:, 5] *= 0.1  # it has nothing to say
    return ratios, rng.random(60)


def test_shares_go_to_the_least_second_moment():
    ratios, weights = made_ratios()
    share = dictionary._shares(ratios, weights, 0.25, np.ones(8), 20_000)
    slopes = (weights / (0.25 + ratios @ share) ** 2) @ ratios
    assert share.sum() == pytest.approx(0.75)
    used = share > 1e-6
    assert 1 < used.sum() < 8
    assert slopes[used] == pytest.approx(slopes[used].mean(), rel=1e-3)
    assert (slopes[~used] < slopes[used].min()).all()


def test_the_rounds_are_those_that_are_best_for_rows_left_out():
    rows = 40
    common = np.full((rows, 1), 3.0)
    own = 1000.0 * np.eye(rows)  # each entry explains a row of its own, and no other
    memory = dictionary._best_rounds(np.hstack([common, own]), np.ones(rows), 0.25, np.ones(rows + 1))
    assert memory == 1
    useless = np.full((rows, rows), 0.1)
    assert dictionary._best_rounds(np.hstack([common, useless]), np.ones(rows), 0.25, np.ones(rows + 1)) > 5


def test_a_fit_takes_the_rounds_that_pay(monkeypatch):
    rng = np.random.default_rng(6)
    tapes = rng.standard_normal((2, 100, 21, 6))
    tapes[..., 7, 4] = 3.5 * np.sign(tapes[..., 7, 4])

    def second_moment():
        mixture = dictionary.fit(tapes[0], np.ones(100), 0.25)
        return np.mean(1.0 / (0.25 + 0.75 * np.exp(-mixture.log_ratio_of(tapes[1]))))

    chosen = second_moment()
    monkeypatch.setattr(dictionary, "_best_rounds", lambda *_: 1)
    assert chosen < 0.7 * second_moment()
