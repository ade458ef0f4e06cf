"""Paired comparison of two versions of a system on the same noise."""

import itertools
import json
import math
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

import avrare
from avrare.analysis.compare.paired_comparison import compare_pairs, compare_versions
from avrare.analysis.compare.version_changes import PairedCounts
from avrare.base.errors import EveryRolloutBroke, UsageError
from avrare.cli.main import main
from avrare.output.terminal.comparison_table import paired_table
from avrare.rollout.executors.serial import SerialExecutor
from avrare.stack.new_scenario import write_python_scenario

LANE_CHANGE = str(Path(__file__).parents[3] / "scenarios" / "lane_change_published.yaml")


@dataclass
class Fails:
    """System that fails if the noise exceeds ``limit``, with an error above ``breaks``."""

    limit: float
    breaks: float = np.inf
    noise_size: int = 1

    def initial(self, noise):
        return {"x": np.where(noise[:, 0] > self.breaks, np.nan, noise[:, 0])}

    def step(self, state, noise):
        return state

    def signals(self, state):
        """Return the distance below the limit."""
        return {"gap": self.limit - state["x"]}


def problem(limit, **options):
    return avrare.Problem(Fails(limit, **options), avrare.stl("always (gap > 0)"), 0, chunk=100)


def pairs(first, second, rollouts=400, seed=0, executor=None):
    return compare_pairs(first, second, rollouts, seed, executor or SerialExecutor())[0]


@pytest.mark.slow
def test_the_interval_covers_the_true_difference_and_is_far_narrower_than_an_unpaired_one():
    from statistics import NormalDist

    truth = NormalDist().cdf(-1.4) - NormalDist().cdf(-1.5)
    found = [pairs(problem(1.5), problem(1.4), seed=seed) for seed in range(400)]
    bounds = np.array([pair.interval(0.9) for pair in found])
    covered = ((bounds[:, 0] <= truth) & (truth <= bounds[:, 1])).mean()
    assert covered > 0.9 - 4 * np.sqrt(0.09 / len(found))
    differences = np.array([pair.difference for pair in found])
    assert abs(differences.mean() - truth) < 4 * differences.std() / np.sqrt(len(found))
    unpaired = np.sqrt(2 * 0.07 * 0.93 / 400)
    assert differences.std() < 0.5 * unpaired


def outcomes(rollouts, worse, better):
    """Yield all counts with their probability, for the shares of rollouts newly failing and mended."""
    for differ in range(rollouts + 1):
        many = stats.binom.pmf(differ, rollouts, worse + better)
        if many > 1e-6:
            of_them = stats.binom.pmf(np.arange(differ + 1), differ, worse / (worse + better))
            for count, chance in enumerate(of_them):
                yield PairedCounts("", 0, differ - count, count, rollouts - differ), many * chance


@pytest.mark.parametrize(
    ("rollouts", "worse", "better", "least"),
    [
        (30, 0.3, 0.1, 0.94), (30, 0.35, 0.25, 0.94), (30, 0.6, 0.3, 0.94),
        (1000, 0.004, 0.002, 0.935),
    ],
)  # fmt: skip
def test_the_interval_covers_at_any_discordance(rollouts, worse, better, least):
    """Sum the coverage over all outcomes; treating the two counts as independent has .86 at .9."""
    covered = total = 0.0
    for pair, chance in outcomes(rollouts, worse, better):
        low, high = pair.interval(0.95)
        covered += chance * (low <= worse - better <= high)
        total += chance
    assert total == pytest.approx(1.0, abs=1e-4)
    assert covered >= least


@pytest.mark.parametrize("each", [0.002, 0.005, 0.02])
def test_an_unchanged_stack_rarely_differs_significantly(each):
    assert sum(chance for pair, chance in outcomes(400, each, each) if pair.p_value < 0.05) <= 0.055


@pytest.mark.parametrize("errors", [0, 2])
def test_words_p_value_and_interval_agree(errors):
    for better, worse in itertools.product(range(9), range(9)):
        pair = PairedCounts("", 5, better, worse, 30, errors)
        low, high = pair.interval(0.9)
        excluded = low > 0.0 or high < 0.0
        assert (pair.p_value < 0.1) == excluded
        assert (pair.verdict(0.9) in ("worse", "better")) == (excluded and pair.different >= 10)


def test_the_interval_ends_where_the_score_test_rejects():
    """Compute the statistic by its definition, with the likelihood maximised on a grid."""
    for end in PairedCounts("", 0, 9, 12, 23).interval(0.95):
        share = np.linspace(max(0.0, -end) + 1e-9, (1.0 - end) / 2.0 - 1e-9, 200_001)
        likely = 9 * np.log(share) + 12 * np.log(share + end) + 23 * np.log(1.0 - 2.0 * share - end)
        best = share[np.argmax(likely)]
        by_hand = (3 - 44 * end) / math.sqrt(44 * (2 * best + end - end**2))
        assert abs(by_hand) == pytest.approx(1.959964, rel=1e-4)


def test_errors_widen_the_interval_of_the_change():
    sound, broken = pairs(problem(1.0), problem(0.9)), pairs(problem(1.0), problem(0.9, breaks=2.0))
    assert broken.errors > 0
    assert broken.count + broken.errors == 400
    assert any("; the first: NaN in signal gap, of the second version" in note for note in broken.notes), (
        broken.notes
    )
    share = broken.errors / 400
    wide, narrow = np.diff(broken.interval(0.95))[0], np.diff(sound.interval(0.95))[0]
    assert wide > narrow + 1.9 * share


def test_all_rollouts_end_with_errors():
    with pytest.raises(EveryRolloutBroke, match="second version: each of the first 200 rollouts"):
        pairs(problem(1.0), problem(1.0, breaks=-np.inf))
    pair = pairs(problem(1.0), problem(1.0, breaks=-np.inf), rollouts=199)
    assert np.isnan(pair.difference)
    assert pair.interval(0.95) == (-1.0, 1.0)


def test_scenarios_that_cannot_be_paired_are_refused():
    named = avrare.Problem(Fails(1.0), {"other": avrare.stl("always (gap > 0)")}, 0)
    with pytest.raises(UsageError, match="no specification in common"):
        pairs(problem(1.0), named)
    longer = avrare.Problem(Fails(1.0), avrare.stl("always (gap > 0)"), 2)
    with pytest.raises(UsageError, match="0 and 2 steps"):
        pairs(problem(1.0), longer)


@dataclass
class Named:
    """System that fails if the noise of one name exceeds 1, and reads others."""

    noise_names: tuple[str, ...]

    @property
    def noise_size(self):
        return len(self.noise_names)

    def initial(self, noise):
        return {"x": noise[:, self.noise_names.index("gust")]}

    def step(self, state, noise):
        return state

    def signals(self, state):
        return {"gap": 1.0 - state["x"]}


def test_noise_is_matched_by_its_names():
    named = [
        avrare.Problem(Named(names), avrare.stl("always (gap > 0)"), 0)
        for names in (("seen", "gust"), ("gust",), ("seen", "lag", "gust", "gust"), ("gust",))
    ]
    for first, second in itertools.permutations(named, 2):
        pair = pairs(first, second)
        assert pair.different == 0
        assert pair.both > 30


def test_the_first_version_has_the_rollouts_of_a_run():
    walk = avrare.Problem(Named(("lag", "gust")), avrare.stl("always (gap > 0)"), 0)
    pair = pairs(walk, avrare.Problem(Named(("gust", "wind")), avrare.stl("always (gap > 0)"), 0), seed=5)
    alone = avrare.estimate(walk, "mc", rollouts=400, seed=5)
    assert pair.both + pair.only_first == alone.failures.count


@pytest.mark.parametrize("ratio", [0.6, 1.0, 1.7])
def test_the_ratio_is_judged_by_the_likeliest_shares(ratio):
    """Compute the statistic by its definition, with the likelihood maximised on a grid."""
    both, first, second, total = 5, 9, 4, 100
    common, alone = np.meshgrid(np.linspace(1e-4, 0.3, 1500), np.linspace(1e-4, 0.3, 1500))
    other = ratio * alone + (ratio - 1.0) * common
    rest = 1.0 - common - alone - other
    with np.errstate(invalid="ignore", divide="ignore"):
        likely = both * np.log(common) + first * np.log(other) + second * np.log(alone)
        likely = np.nan_to_num(likely + (total - both - first - second) * np.log(rest), nan=-np.inf)
    best = np.unravel_index(likely.argmax(), likely.shape)
    spread = total * (other + ratio**2 * alone + (1.0 - ratio) ** 2 * common)[best]
    by_hand = ((both + first) - ratio * (both + second)) / math.sqrt(spread)
    confidence = 1.0 - math.erfc(abs(by_hand) / math.sqrt(2.0))
    ends = PairedCounts("", both, first, second, total - both - first - second).ratio_interval(confidence)
    assert min(abs(end - ratio) for end in ends) < 2e-3


def test_the_ratio_of_equal_counts_is_symmetric():
    low, high = PairedCounts("", 3, 2, 2, 90).ratio_interval(0.95)
    assert low * high == pytest.approx(1.0)
    assert PairedCounts("", 3, 5, 2, 90).ratio_interval(0.95)[0] == pytest.approx(
        1.0 / PairedCounts("", 3, 2, 5, 90).ratio_interval(0.95)[1]
    )


@pytest.mark.parametrize(("worse", "better"), [(0.01, 0.004), (0.002, 0.002), (0.02, 0.002)])
def test_the_interval_of_the_ratio_covers(worse, better):
    """Sum the coverage over all outcomes in which a version fails."""
    covered = total = 0.0
    for pair, chance in outcomes(1000, worse, better):
        if pair.different:
            low, high = pair.ratio_interval(0.95)
            covered += chance * (low <= better / worse <= high)
            total += chance
    assert covered / total >= 0.93


def test_neither_version_fails():
    pair = PairedCounts("s", 0, 0, 0, 1000)
    assert pair.verdict(0.95) == "not known"
    assert pair.describe_ratio(0.95) == "at most 0.0037 each"
    assert math.isnan(pair.ratio)
    assert PairedCounts("s", 3, 0, 0, 997).verdict(0.95) == "same"


def test_no_version_is_better_where_more_rollouts_are_asked_for():
    for different in range(1, 30):
        pair = PairedCounts("s", 3, different, 0, 900)
        asked = any("use more" in note for note in pair.notes)
        assert asked == (pair.verdict(0.95) == "not known") == (different < 10)


def test_one_version_never_fails():
    pair = PairedCounts("s", 0, 8, 0, 992)
    assert pair.describe_ratio(0.95) == "at least 2.1"
    assert PairedCounts("s", 0, 0, 8, 992).describe_ratio(0.95) == "0 (at most 0.48)"


def test_errors_may_decide_the_ratio_either_way():
    low, high = PairedCounts("s", 10, 10, 10, 960, errors=10).ratio_interval(0.95)
    assert low < PairedCounts("s", 10, 10, 20, 960).ratio_interval(0.95)[0] + 1e-9
    assert high > PairedCounts("s", 10, 20, 10, 960).ratio_interval(0.95)[1] - 1e-9


@pytest.mark.slow
def test_on_the_command_line(tmp_path, capsys):
    words = ["compare", LANE_CHANGE, "--against", LANE_CHANGE, "--set", "scenario.steps=3"]
    more = ["--set", "against.controller.turn_rate_change_weight=1", "--budget", "rollouts=6"]
    assert main([*words, *more, "--out", str(tmp_path)]) == 0
    screen = capsys.readouterr().out
    assert "with other settings: 6 rollouts each, on the same noise" in screen
    assert "no_abrupt_braking" in screen
    assert main([*words, *more, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content == json.loads((tmp_path / "paired.json").read_text())
    assert content["fingerprints"][0] != content["fingerprints"][1]
    assert content["specifications"][0]["errors"] == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--set", "ams.particles=3"], "a setting of two versions begins with scenario. or against."),
        (["--budget", "seconds=3"], "is not comparable: its cost differs between machines and runs"),
        (["--set", "against.steps=20"], "cannot share their noise"),
    ],
)
def test_mistakes_are_reported(words, told, capsys):
    assert main(["compare", LANE_CHANGE, "--against", LANE_CHANGE, *words]) == 4
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(("only_first", "only_second", "worse"), [(0, 3, False), (0, 4, True), (0, 0, False)])
def test_few_differing_rollouts_are_not_significant(only_first, only_second, worse):
    pair = PairedCounts("s", 0, only_first, only_second, 10_000 - only_first - only_second)
    low, high = pair.interval(0.95)
    assert (low > 0.0) == worse
    assert high > 3.6e-4
    assert (pair.p_value < 0.05) == worse


def test_versions_without_a_difference_or_without_an_outcome(tmp_path):
    """Say "itself" of the same settings, and "not known" where all rollouts end in an error."""
    file = tmp_path / "acc.yaml"
    write_python_scenario(file)
    same = compare_versions(file, file, budget="rollouts=4")
    assert same.headline() == [f"{file} against itself: 4 rollouts each, on the same noise"]
    broken = compare_versions(
        file, file, budget="rollouts=4", overrides=["against.simulator.options.radar=.nan"]
    )
    assert "acc.yaml with other settings" in broken.headline()[0]
    assert "not known" in broken.summary()[0]
    console = Console(file=StringIO(), width=200)
    console.print(paired_table(broken))
    assert console.file.getvalue().count("not known") == 5
    assert "nan" not in console.file.getvalue()
