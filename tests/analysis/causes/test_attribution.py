"""Attribution on systems in which it is known what carries the failures."""

from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.analysis.causes.attribution import attribute, attribution_of_result
from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.noise_groups import clip_outliers, list_groups, make_perfect
from avrare.analysis.causes.savings import Saving, measure_saving
from avrare.analysis.causes.tape_runs import TapeRunner, Verdicts, draw_tapes
from avrare.base.errors import UsageError
from avrare.estimation.result.result import Failures
from avrare.testing.faulty_systems import Walk
from avrare.testing.static_problems import Static
from avrare_design.sensitivity import sample_failures
from noisy_loop import Drawn, noisy_problem


def static(formula, size=3):
    return avrare.Problem(Static(size), avrare.stl(formula), steps=0)


@pytest.fixture(scope="module")
def only_first():
    result = avrare.estimate(static("always (u0 < 2)"), rollouts=3000, seed=1)
    return attribution_of_result(result, fresh=1000)


def test_what_alone_can_fail_carries_everything(only_first):
    first, *others = only_first.shares
    assert first.name == "noise 0"
    assert first.alone == 1.0
    assert first.carries_interval[0] > 0.85
    for other in others:
        assert other.carries == 0.0
        assert other.carries_interval[1] < 0.1
        assert other.alone_interval[1] < 0.15


def test_only_its_perfection_saves(only_first):
    best, *others = only_first.savings
    assert best.name == "perfect noise 0"
    assert (best.vanish, best.new) == (1.0, 0.0)
    assert best.saved_interval[0] > 0.3
    assert all(one.vanish == 0.0 for one in others if one.name.startswith("perfect"))


def test_both_parts_of_a_sum_are_needed_and_neither_is_enough():
    # For X + Y > c the indices are known: the total one from P(fails | Y), the first-order one from both.
    result = avrare.estimate(static("always (u0 + u1 < 2.5)", 2), rollouts=4000, seed=1)
    for share in attribution_of_result(result, fresh=0).shares:
        low, high = share.carries_interval
        assert low < 0.812 < high
        low, high = share.alone_interval
        assert low < 0.188 < high


def test_a_part_may_do_harm():
    # Noise 0 alone keeps the rest from failing: perfect, it lets them.
    result = avrare.estimate(static("always (u0 > 1.5 or u1 < 2.2)", 2), rollouts=4000, seed=1)
    found = {one.name: one for one in attribution_of_result(result, fresh=4000).savings}
    harmful = found["perfect noise 0"]
    assert harmful.new > 0.0
    assert harmful.saved < 0.0
    assert found["perfect noise 1"].saved == 1.0


def test_the_first_half_of_a_walk_that_must_be_high_early():
    problem = avrare.Problem(Walk(scale=1.0), avrare.stl("always[0, 9] (x < 6)"), steps=19)
    result = avrare.estimate(problem, rollouts=3000, seed=1)
    sample = FailureSample.of(result)
    found = attribute(problem, sample, fresh=0, groups=list_groups(problem, windows=2))
    early, late, start = found.shares
    assert (early.name, early.sort) == ("steps 0-9", "time")
    assert early.alone == 1.0
    assert late.carries == 0.0
    assert (start.name, start.sort) == ("start", "start")


def test_a_variant_is_run_on_the_same_tapes():
    problem, wider = static("always (u0 < 2)"), static("always (u0 < 9)")
    result = avrare.estimate(problem, rollouts=1000, seed=1)
    found = attribute(problem, FailureSample.of(result), fresh=100, groups=[], variants={"wider": wider})
    assert {one.name: one.vanish for one in found.savings}["wider"] == 1.0


def test_a_variant_with_other_noise_is_refused():
    problem = static("always (u0 < 2)")
    result = avrare.estimate(problem, rollouts=1000, seed=1)
    other = {"larger": static("always (u0 < 2)", 4)}
    with pytest.raises(UsageError, match="larger: its tapes have another shape"):
        attribute(problem, FailureSample.of(result), fresh=0, groups=[], variants=other)


def test_the_same_seed_gives_the_same_numbers_for_any_chunk():
    results = []
    for chunk in (7, 500):
        problem = avrare.Problem(Static(2), avrare.stl("always (u0 + u1 < 2.5)"), steps=0, chunk=chunk)
        result = avrare.estimate(problem, rollouts=800, seed=1)
        results.append(attribution_of_result(result, fresh=50).table())
    assert results[0] == results[1]


def test_groups_of_a_driving_scenario_have_its_names():
    problem = avrare.load("scenarios/lane_change_published.yaml").problem("no_collision")
    groups = {group.name: group for group in list_groups(problem)}
    assert groups["detection"].sort == "error"
    assert groups["all noise of parked"].mask[0].sum() == 4
    assert "perception" in groups
    tapes = draw_tapes(problem, 0, 0, 2)
    perfect = make_perfect(problem, tapes, groups["detection"].mask)
    assert (perfect[..., 0] == -8.0).all()
    assert (perfect[..., 1] == tapes[..., 1]).all()
    clipped = clip_outliers(problem, tapes, 1.0)
    assert (clipped[..., 0] == tapes[..., 0]).all()
    assert np.abs(clipped[..., 1]).max() <= 1.0


def test_draws_are_a_group_of_their_own_that_nothing_makes_perfect():
    problem = noisy_problem(start=Drawn())
    sample = sample_failures(problem, 2000, 1, 0.95, TapeRunner())
    found = attribute(problem, sample, fresh=0, groups=list_groups(problem, windows=0))
    assert [(one.name, one.carries) for one in found.shares[:2]] == [("start", 0.0), ("perception", 1.0)]
    perfect = {one.name: one.vanish for one in found.savings}
    assert perfect["perfect perception"] == 1.0
    assert not any("draw" in name for name in perfect)
    tapes = 9.0 * sample.failures.noise
    whole = np.ones(tapes.shape[1:], dtype=bool)
    for changed in (clip_outliers(problem, tapes, 1.0), make_perfect(problem, tapes, whole)):
        assert (changed[..., :2] == tapes[..., :2]).all()
        assert (changed[..., 2] != tapes[..., 2]).any()


def test_a_part_with_one_named_number_has_its_name():
    problem = noisy_problem()
    problem.system.noise_names = ("radar",)
    assert [group.name for group in list_groups(problem, windows=0)][:1] == ["radar"]


def saving(vanish, vanish_interval, new, new_interval, saved, saved_interval):
    return Saving("part", vanish, vanish_interval, new, new_interval, saved, saved_interval)


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        ((1.0, (0.85, 1.0), 0.0, (0.0, 0.0037), 1.0, (0.85, 1.0)), "saves at least 85 % of them"),
        (
            (1.0, (0.85, 1.0), 0.0, (0.0, 0.0037), 1.0, (-218.26, 1.0)),
            "saves at least 85 % of them; no new ones were seen, at most 0.0037",
        ),
        (
            (0.33, (0.2, 0.5), 0.02, (0.015, 0.03), -6.0, (-9.0, -4.0)),
            "makes failures 7 times as likely, at least 5 times: saves 33 % of them, at least 20 %; "
            "new ones 0.02, at most 0.03",
        ),
        (
            (0.33, (0.2, 0.5), 0.0, (0.0, 1.0), 0.0, (-np.inf, 0.5)),
            "saves 33 % of them, at least 20 %; new ones were not looked for",
        ),
        (
            (0.1, (0.01, 0.27), 0.0, (0.0, 0.0037), 0.1, (-218.0, 0.3)),
            "saves 10 % of them, at most 27 %; no new ones were seen, at most 0.0037",
        ),
    ],
)
def test_what_a_change_does_is_told_by_what_is_shown(effect, text):
    assert saving(*effect).describe() == text


def test_other_planners_are_tried_without_being_asked_for():
    settings = ["controller.braking=1.0", "simulator.draws={}", "simulator.parameters.Closing=6.0"]
    problem = avrare.load("scenarios/motorway_cut_in.yaml", settings).problem("no_collision")
    sample = sample_failures(problem, 300, 1, 0.95, TapeRunner())
    found = attribute(problem, sample, fresh=0, groups=[])
    vanish = {saving.name: saving.vanish for saving in found.savings}
    assert {name for name in vanish if name.startswith("planner")} == {
        "planner that begins emergency braking earlier",
        "planner that brakes earlier and harder",
        "planner that sees the truth",
    }
    assert vanish["planner that brakes earlier and harder"] > vanish["planner that sees the truth"]
    assert found.savings[-1].name == "start at its median"


def test_one_failure_is_too_few():
    problem = static("always (u0 < 2)")
    result = avrare.estimate(problem, rollouts=1000, seed=1)
    sample = FailureSample.of(result).take(np.array([0]))
    with pytest.raises(UsageError, match="1 failure is too few"):
        attribute(problem, sample, fresh=0, groups=[])


class Breaking(Static):
    """System whose rollouts break down where u1 is below a limit."""

    def __init__(self, below):
        super().__init__(3)
        self.below = below

    def faults(self, state):
        return state.values[:, 1] < self.below


def attribute_breaking(below, fresh=200):
    problem, formula = static("always (u0 < 2)"), avrare.stl("always (u0 < 2)")
    sample = FailureSample.of(avrare.estimate(problem, rollouts=2000, seed=1))
    variants = {"breaking": avrare.Problem(Breaking(below), formula, steps=0)}
    return attribute(problem, sample, fresh=fresh, groups=[], variants=variants), sample


def test_rollouts_that_break_down_do_not_vanish():
    found, sample = attribute_breaking(0.0)
    broken = int((sample.failures.noise[:, 0, 1] < 0.0).sum())
    saving = next(one for one in found.savings if one.name == "breaking")
    assert found.errors >= broken > 10
    assert saving.vanish == 0.0
    low, high = saving.vanish_interval
    assert (low, high > broken / sample.size) == (0.0, True)
    assert saving.new == 0.0
    assert saving.new_interval[1] > 0.4


def test_a_variant_that_always_breaks_down_is_refused():
    with pytest.raises(UsageError, match="rollouts with breaking broke down"):
        attribute_breaking(np.inf)


def test_the_interval_of_what_is_saved_knows_that_the_estimate_is_one():
    # Every failure vanishes, and 0.8 p new ones appear on many tapes: only p is uncertain.
    p, rollouts, fresh, covered = 0.005, 2000, 200_000, 0
    rng, none = np.random.default_rng(1), np.zeros(200_000, dtype=bool)
    for count in rng.binomial(rollouts, p, size=40):
        kept = Failures(np.zeros((count, 1, 1)), np.zeros(count), int(count))
        sample = FailureSample(kept, count / rollouts, 0.3, rollouts, 1, 0, 0.95)
        stored, now = np.zeros(count, dtype=bool), np.arange(fresh) < rng.binomial(fresh, 0.8 * p)
        saving = measure_saving(
            sample, "part", Verdicts(stored, stored), Verdicts(none, none), Verdicts(now, none)
        )
        covered += saving.saved_interval[0] <= 0.2 <= saving.saved_interval[1]
    assert covered >= 36


def test_nothing_is_surer_than_a_doubted_estimate():
    kept = Failures(np.zeros((40, 1, 1)), np.zeros(40), 40)
    sure = FailureSample(kept, 0.01, 0.1, 4000, 1, 0, 0.95)
    doubted = replace(sure, opened_at=lambda confidence: (0.001, 0.05))
    assert doubted.part_interval(np.arange(40) < 20)[1] == pytest.approx((0.0005, 0.05))
    stored, none = np.zeros(40, dtype=bool), np.zeros(20_000, dtype=bool)

    def measure(sample, new):
        fresh = Verdicts(none, none), Verdicts(np.arange(20_000) < new, none)
        return measure_saving(sample, "part", Verdicts(stored, stored), *fresh).saved_interval

    # All failures that are known vanish, but they may be a fifth of all, of which the others may stay.
    assert measure(sure, 0)[1] == measure(doubted, 0)[1] == 1.0
    assert measure(doubted, 0)[0] < 0.2 < measure(sure, 0)[0]
    # New ones are more than the estimate, but fewer than what it may have missed.
    assert measure(sure, 400)[1] < 0.0 < measure(doubted, 400)[1]
