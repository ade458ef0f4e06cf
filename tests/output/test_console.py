"""Console output: tables, notes and colours."""

from dataclasses import replace

import pytest
from rich.console import Console

import avrare
from avrare.base.number_format import format_confidence, format_probability
from avrare.estimation.plan.plan import Info
from avrare.output.terminal.console import make_console, make_table, print_lines, print_table
from avrare.output.terminal.progress_line import Progress
from avrare.output.terminal.result_table import note_lines, result_table, warning_lines


class Still:
    noise_size = 1

    def initial(self, noise):
        return {"x": noise[:, 0]}

    def step(self, state, noise):
        return state

    def signals(self, state):
        return state


@pytest.fixture(scope="module")
def problem():
    return avrare.Problem(Still(), avrare.stl("always (x < 2)"), steps=1)


def test_the_progress_line_shows_the_state_of_splitting(problem):
    info = Info(
        stage=7, level=-0.42, probability=3.1e-5, survivors=34, particles=100, rollouts=520, failures=3,
        errors=1, counts={"solves": 900, "fallback_solves": 2},
    )  # fmt: skip
    line = Progress("safe_distance  ams", problem).line(info, 10.0)
    for part in (
        "safe_distance  ams", "level 7", "gamma 0.42", "p≈3.1e-05", "survivors 34/100", "rollouts 520",
        "52.0/s", "failures 3", "errors 1", "fallback solves 2",
    ):  # fmt: skip
        assert part in line
    assert "900" not in line


def test_a_narrow_terminal_truncates_no_number(problem):
    result = avrare.estimate(problem, "mc", rollouts=1000, seed=3)
    console = Console(width=30, record=True, soft_wrap=True, file=open("/dev/null", "w"))  # noqa: SIM115
    print_table(console, result_table("title", [result]))
    text = console.export_text()
    assert "…" not in text
    for part in (
        "specification",
        "probability",
        format_probability(result.probability),
        format_probability(result.interval[1], 2),
    ):
        assert part in text


def test_a_warning_shared_by_all_is_shown_once(problem):
    result = avrare.estimate(problem, "ams", particles=100, discard=10, runs=1, seed=3)
    assert "single_run" in result.health
    lines = warning_lines([result, result])
    assert sum("single_run" in line for line in lines) == 1


def test_splitting_says_what_its_score_may_miss_and_monte_carlo_need_not(problem):
    split = avrare.estimate(problem, "ams", particles=100, discard=10, runs=1, seed=3)
    sentence = f"Failures that the score does not lead to could be as likely as {split.blind_bound:.2g}."
    assert sentence in note_lines([split, split])
    counted = replace(avrare.estimate(problem, "mc", rollouts=50), specification="counted")
    assert f"{split.specification}: {sentence}" in note_lines([split, counted])
    assert not note_lines([counted])


@pytest.mark.parametrize("mode", ["plain", "auto"])
def test_a_name_cannot_command_the_terminal(mode, capsys):
    console = make_console(mode)
    table = make_table("title \x1b[2J", ["name"])
    table.add_row("\x1b[31mred")
    print_table(console, table)
    print_lines(console, ["\x1b]0;owned\x07", "\ttab"])
    print("\n".join(avrare.UsageError("bad \x1b[31mname", "\x9b1m").lines()))
    out = capsys.readouterr().out
    for text in ("\x1b[31m", "\x1b[2J", "\x1b]", "\x07", "\x9b"):
        assert text not in out
    for text in ("\\x1b[2J", "\\x1b[31", "\\x1b]0;owned", "bad \\x1b[31mname", "\\x9b1m"):
        assert text in out


def test_a_confidence_keeps_its_digits():
    assert [format_confidence(one) for one in (0.95, 0.999, 0.57, 0.0001)] == ["95%", "99.9%", "57%", "0.01%"]
