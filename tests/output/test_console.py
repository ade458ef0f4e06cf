"""What a terminal shows: tables, notes, colours and numbers, and the progress of an estimate."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from rich.console import Console

import avrare
from avrare.base.number_format import (
    format_amount_in_words,
    format_clock,
    format_confidence,
    format_interval,
    format_probability,
    format_typeset,
)
from avrare.cli.main import main
from avrare.estimation.plan.plan import CostForecast, Info
from avrare.output.terminal.console import make_console, make_table, print_lines, print_table
from avrare.output.terminal.progress_line import Progress, TimeLeft
from avrare.output.terminal.result_table import note_lines, result_table, warning_lines
from plain_systems import Still


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
    numbers = format_probability(result.probability), format_probability(result.interval[1], 2)
    for part in ("specification", "probability", *numbers):
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


SLOW = """\
name: slow
steps: 400
simulator:
  {plugin: linear, dt: 0.1, states: [x], A: [[1]], process_noise: [0.01],
   initial: {mean: [0], covariance: [0.01]}}
specifications:
  low: {stl: "always (x < 1)"}
estimator: {plugin: mc, rollouts: 200000}
chunk: 50
"""


@pytest.mark.parametrize(
    ("seconds", "words"), [(0, "0:00"), (7.4, "0:07"), (754, "12:34"), (12345, "3:25:45"), (1e9, "days")]
)
def test_durations(seconds, words):
    assert format_clock(seconds) == words


def test_monte_carlo_shows_its_interval_and_the_time_left(problem):
    progress = Progress("walk  mc", problem, confidence=0.95)
    line = progress.line(Info(rollouts=100, failures=10, goal=400), 50.0)
    assert "p 0.1 (0.049 .. 0.18)" in line
    assert "rollouts 100/400" in line
    assert "2:30 left" in line
    open_ended = progress.line(Info(rollouts=100, failures=10), 50.0)
    assert "p 0.1  " in open_ended
    assert "left" not in open_ended


@pytest.mark.parametrize(("mode", "lines"), [("auto", 1), ("plain", 1), ("quiet", 0)])
def test_without_a_terminal_plain_lines_are_printed_from_time_to_time(problem, capsys, mode, lines):
    with Progress("walk", problem, mode) as progress:
        progress(Info(rollouts=1))
        progress.printed -= 3600.0
        progress(Info(rollouts=2))
        progress(Info(rollouts=3))
    err = capsys.readouterr().err
    assert err.count("\n") == lines
    assert "\x1b" not in err


@pytest.fixture
def scenario(tmp_path):
    (tmp_path / "slow.yaml").write_text(SLOW)
    return str(tmp_path / "slow.yaml")


def test_quiet_prints_the_verdicts_alone(scenario, tmp_path, capsys):
    few = ["--set", "estimator.rollouts=20", "--set", "steps=3", "--out", str(tmp_path / "out")]
    assert main(["run", scenario, "--quiet", *few]) == 0
    out = capsys.readouterr()
    assert re.fullmatch(r"slow low: no threshold, 0 \(0 \.\. 0\.17\)\n", out.out)
    assert out.err == ""
    low = 'specifications.low.stl="eventually (x > 9)"'
    assert main(["run", scenario, "--quiet", "--set", low, *few]) == 0
    assert capsys.readouterr().out.endswith(" .. 1), all_failed\n")
    assert main(["run", scenario, "--quiet", "--plain", *few]) == 4


def test_plain_has_no_control_characters_where_colours_are_forced(scenario, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    few = ["--set", "estimator.rollouts=20", "--set", "steps=3", "--out", str(tmp_path / "out")]
    assert main(["run", scenario, "--plain", *few]) == 0
    out = capsys.readouterr()
    assert "\x1b" not in out.out + out.err
    assert "results in" in out.out


class Terminal:
    """Command that runs on a terminal of 90 columns."""

    def __init__(self, *words, **environment):
        self.ours, theirs = pty.openpty()
        self.seen = ""
        settings = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "90", "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "avrare", *words],
            stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
            env={**settings, **environment},
            # a shell that runs the tests in the background lets all below it ignore Ctrl-C
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )  # fmt: skip
        os.close(theirs)

    def wait(self, pattern, seconds=60.0):
        """Wait until the output matches the pattern."""
        end = time.monotonic() + seconds
        while not re.search(pattern, self.seen):
            alive = self.process.poll() is None and time.monotonic() < end
            assert alive, f"never seen: {pattern}\n{self.seen[-2000:]}"
            if select.select([self.ours], [], [], 0.1)[0]:
                self._read()

    def ended(self):
        """Read the remaining output and return the exit code."""
        while self.process.poll() is None or select.select([self.ours], [], [], 0.1)[0]:
            if select.select([self.ours], [], [], 0.1)[0] and not self._read():
                break
        return self.process.wait(timeout=60)

    def _read(self):
        try:
            found = os.read(self.ours, 65536).decode("utf-8", "replace")
        except OSError:  # the other end is closed
            return False
        self.seen += found
        return bool(found)


@pytest.mark.slow
def test_on_a_terminal_lines_are_live_and_ctrl_c_saves(scenario, tmp_path):
    terminal = Terminal("run", scenario, "--out", str(tmp_path / "torn"), "--no-pictures")
    try:
        terminal.wait(r"[1-9]\d* of 200,000 rollouts")
        terminal.wait(r"p 0(\.\d+)? \(")
        assert "\x1b[" in terminal.seen
        terminal.process.send_signal(signal.SIGINT)
        code = terminal.ended()
    finally:
        terminal.process.kill()
    assert code == 2, terminal.seen
    assert re.search(r"interrupted, [1-9]\d* chunks are saved", terminal.seen)
    assert "resume with" in terminal.seen
    assert "Traceback" not in terminal.seen
    assert (tmp_path / "torn" / "checkpoint").is_dir()


def left(info, seconds, first=None, steady=True):
    time_left = TimeLeft(steady)
    if first is not None:
        time_left.see(*first)
    return "; ".join(time_left.words(info, seconds))


@pytest.mark.parametrize(
    ("forecast", "words"),
    [
        (CostForecast("rollouts", 400, 400), "0:30 left"),
        (CostForecast("rollouts", 400, 1000, "p 0.01 .. 1e-06"), "0:30 .. 1:30 left (p 0.01 .. 1e-06)"),
        (CostForecast("rollouts", 0, 1000), "up to 1:30 left"),
        (CostForecast("rollouts", 400, float("inf"), "no failure"), "at least 0:30 left (no failure)"),
        (CostForecast("steps", 8000, 8000), "1:10 left"),
        (CostForecast("seconds", 25, 25), "0:15 left"),
        (CostForecast("rollouts", 50, 90), ""),
        (None, ""),
    ],
)  # fmt: skip
def test_the_time_left_has_bounds_and_what_they_rest_on(forecast, words):
    assert left(Info(rollouts=100, steps=1000, forecast=forecast), 10.0) == words


def test_a_long_stage_has_a_total_of_its_own():
    info = Info(rollouts=100, stage_rows=1000, stage_done=100)
    assert left(info, 10.0) == "stage 100/1000, 1:30 left in it"
    assert left(replace(info, goal=1000), 10.0) == "1:30 left"


def test_the_start_of_workers_leaves_the_pace_once_as_much_time_has_passed():
    slow_start, forecast = Info(rollouts=10), CostForecast("rollouts", 410, 410)
    later = Info(rollouts=210, forecast=forecast)
    assert left(replace(later, rollouts=10), 10.0, first=(slow_start, 10.0)) == "6:40 left"
    assert left(later, 20.0, first=(slow_start, 10.0)) == "0:10 left"
    assert left(later, 20.0, first=(slow_start, 10.0), steady=False) == "0:19 left"


def test_numbers_are_formatted_for_people():
    words = {0.0: "0", 1.0: "1", 0.01234: "0.0123", 3.44e-5: "3.4 × 10⁻⁵", None: "–", 1e-12: "1.0 × 10⁻¹²"}
    assert {value: format_typeset(value) for value in words} == words


def test_amounts_are_written_in_words():
    words = {12.3: "12", 1234.0: "1,200", 3.44e6: "3.4 million", 1.23e8: "120 million", 9.99e8: "1.0 × 10⁹"}
    assert {value: format_amount_in_words(value) for value in words} == words


def test_a_bound_below_one_is_told_from_one():
    assert format_interval((0.9963, 1.0)) == "0.996 .. 1"
    assert format_interval((0.2, 0.99)) == "0.2 .. 0.99"
