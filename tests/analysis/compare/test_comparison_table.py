"""Table, Markdown and plot of a comparison."""

from dataclasses import replace

import pytest
from rich.console import Console

from avrare.analysis.compare.case import ComparisonCase, GroundTruth
from avrare.analysis.compare.comparison import ArmResult, Comparison, StudyDesign
from avrare.analysis.compare.estimator_options import parse_arms
from avrare.base.errors import UsageError
from avrare.base.number_format import format_amount
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.note import Note
from avrare.output.plots.estimate_plots import plot_comparison
from avrare.output.terminal.comparison_table import comparison_table, markdown
from avrare.plugin.registry import default_registry
from avrare.testing.problems import walk
from plain_results import plain_result

P = 1.165e-4
LONG = "is:proposal={name: gaussian, mean: 0.4, std: 1.1}"


def repetitions(values, health=()):
    fields = {
        "rollouts": 9876,
        "simulated_steps": 987_600,
        "failures": 3,
        "health": dict.fromkeys(health, ""),
    }
    return tuple(
        plain_result(probability=value, interval=(value / 2, max(2 * value, 1e-5)), **fields)
        for value in values
    )


@pytest.fixture
def comparison():
    mc, ams, weighted = parse_arms(f"mc,ams:particles=100,{LONG}", [], None, default_registry())
    entries = (
        ArmResult(mc, repetitions([0.0, 1e-4, 0.0, 0.0])),
        ArmResult(ams, repetitions([1.1e-4, 1.3e-4, 1.2e-4, 0.9e-4], ("few_roots",))),
        ArmResult(weighted, refusal=UsageError("it does not fit")),
    )
    design = StudyDesign(Budget("steps", 1e6), repeat=4)
    problem = walk(3.8, 100).problem()
    return Comparison(ComparisonCase("walk", "", problem), design, entries, GroundTruth(P, "exact"))


def shown(comparison, width=100):
    console = Console(width=width, record=True, force_terminal=False, color_system=None)
    with console.capture() as captured:
        console.print(comparison_table(comparison))
    return captured.get()


def test_the_table_fits_a_hundred_columns_and_truncates_nothing(comparison):
    text = shown(comparison)
    assert max(map(len, text.splitlines())) <= 100
    assert "…" not in text
    for part in ("1.1e-4", "0.966", "0.13", "4/4", "988k", "3/4"):
        assert f" {part} " in text or f" {part}\n" in text, part
    first_column = "".join(line.split("  ")[0] for line in text.splitlines())
    assert "ams:particles=100" in first_column
    assert LONG.replace(" ", "") in first_column.replace(" ", "")


def test_notes_name_unreliable_rows(comparison):
    lines = comparison.notes()
    assert f"{LONG} cannot take this problem: it does not fit" in lines
    assert "mc: most estimates are zero: a few more repetitions may change its numbers a lot" in lines
    assert "ams:particles=100: health warnings: few_roots in 4 of 4 repetitions" in lines
    assert len(lines) == 3


def test_notes_name_the_first_error(comparison):
    note = Note("errors", "2 of 100 rollouts ended in an error; the first: NaN in signal x")
    few = replace(plain_result(), notes=(note,))
    many = replace(plain_result(), health={"errors": "9 of 100 rollouts ended in an error: NaN in signal y"})
    mc, ams, refused = comparison.arms
    arms = (replace(mc, repetitions=(plain_result(), few, many)), replace(ams, repetitions=(many,)), refused)
    notes = replace(comparison, arms=arms).notes()
    assert f"mc: {note.text}" in notes
    assert f"ams:particles=100: {many.health['errors']}" in notes


@pytest.mark.parametrize("budget", [Budget("steps", 987_600 / 1.6), Budget("rollouts", 9876 / 1.6)])
def test_notes_name_estimators_that_exceed_the_budget(comparison, budget):
    notes = replace(comparison, design=replace(comparison.design, budget=budget)).notes()
    assert "ams:particles=100: takes 1.6 times the budget" in notes


def test_notes_on_the_truth(comparison):
    assert "the truth is unknown" in replace(comparison, truth=None).notes()[1]
    pooled = GroundTruth(P, "pooled monte carlo", None, 144)
    assert "144 failures: relative error 8%" in replace(comparison, truth=pooled).notes()[1]
    assert "p unknown" in replace(comparison, truth=None).headline()[0]


def test_markdown_is_one_table(comparison):
    rows = [line for line in markdown(comparison).splitlines() if line.startswith("|")]
    assert len(rows) == 2 + 3
    assert {row.count("|") for row in rows} == {11}
    assert "| `ams:particles=100` | 1.1e-4 (" in rows[3]
    assert rows[4].startswith(f"| `{LONG}` | - |")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (0.423, "0.42"), (7.34, "7.3"), (9.99, "10"), (85.2, "85"), (790, "790"), (999.7, "1.0k"),
        (1234, "1.2k"), (99_999, "100k"), (3.4e6, "3.4M"), (5.6e9, "5.6e9"), (float("inf"), "inf"),
    ],
)  # fmt: skip
def test_numbers_are_short(value, text):
    assert format_amount(value) == text


def test_the_picture(comparison, tmp_path):
    nothing = replace(
        comparison, arms=(replace(comparison.arms[0], repetitions=repetitions([0.0] * 3)),), truth=None
    )
    for name, content in (("some", comparison), ("nothing", nothing)):
        plot_comparison(content).save(tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
