"""Notes and warnings of an estimate: the same words in terminal, report and notebook."""

import json
import re
from functools import cache
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.estimation.combine.ensemble import combine
from avrare.output.terminal.console import make_console, print_lines
from avrare.output.terminal.result_table import note_lines, warning_lines
from avrare.results.stored_results import StoredEstimate
from avrare.testing.faulty_systems import Fragile, Scrambled, Walk
from avrare.testing.problems import count_down

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "python.md"
pytestmark = pytest.mark.filterwarnings("ignore::avrare.base.errors.HealthWarning")
STEPS = 20


class Starts(Walk):
    """A walk that begins beyond its bound where the second number of its start is large."""

    noise_size = 2

    def initial(self, noise):
        return {"x": np.where(noise[:, 1] > 3.2, 9.0, 0.0)}


class Solved(Walk):
    """A walk with counters."""

    def counts(self, state):
        rows = np.ones(len(state["x"]), dtype=np.int64)
        return {"solves": 400 * rows, "fallback_solves": rows, "skipped_frames": 2 * rows}


def problem(limit=1.2, system=None, steps=STEPS):
    return avrare.Problem(system or Walk(), avrare.stl(f"always (x < {limit})"), steps)


def estimate(name, task=None, **options):
    return avrare.estimate(task or problem(), name, seed=0, **options)


def estimate_ensemble():
    members = [estimate("mc", problem(limit), rollouts=1000) for limit in (0.5, 0.55, 0.6)]
    return combine(members[0], 3, None, dict(enumerate(members)))


SMALL = {"particles": 50, "discard": 5}
MAKERS = {
    "goal": lambda: estimate("mc", rollouts=200, relative_error=0.01),
    "goal of runs": lambda: estimate("ams", relative_error=0.01, runs=5, most_runs=5, **SMALL),
    "goal of rows": lambda: estimate("is", rollouts=3000, relative_error=0.01),
    "goal reached": lambda: estimate("mc", problem(0.3), threshold=0.9),
    "pilot": lambda: estimate("ams", particles=20, discard=4, grow=True),
    "learning": lambda: estimate("is", problem(0.05, Scrambled(STEPS)), rollouts=3000),
    "ties": lambda: estimate("ams", count_down(4, 9, "1/5").problem(), particles=50, discard=2, runs=2),
    "twin": lambda: estimate("mfmc", problem().with_twin(problem(1.3), 0.02), rollouts=2000),
    "twin in vain": lambda: estimate("mfmc", problem().with_twin(problem(1.3), 0.02), rollouts=200),
    "counts": lambda: estimate("mc", problem(system=Solved()), rollouts=50),
    "errors": lambda: estimate("mc", problem(system=Fragile("nan", 3.0, at_start=True)), rollouts=1000),
    "blind": lambda: estimate("ams", runs=4, **SMALL),
    "witness": lambda: estimate("is", rollouts=20_000),
    "doubt": lambda: estimate("ams", particles=30, discard=10, runs=3),
    "choice": lambda: estimate("auto", problem(0.5), rollouts=5000),
    "model": estimate_ensemble,
    "cross_check": lambda: estimate("ams", runs=4, cross_check={"share": 1.0}, **SMALL),
}
"""Estimates by the kind of note that they have."""


@cache
def make(case):
    return MAKERS[case]()


def show_in_terminal(result, tmp_path, capsys):
    console = make_console("plain")
    print_lines(console, [*warning_lines([result]), *note_lines([result])])
    return capsys.readouterr().out


def show_in_report(result, tmp_path, capsys):
    return unescape(result.report(tmp_path / "report.html").read_text())


def show_in_notebook(result, tmp_path, capsys):
    return unescape(result._repr_html_())


RENDERERS = [show_in_terminal, show_in_report, show_in_notebook]


def test_every_kind_is_shown_and_documented():
    sources = [*ROOT.glob("avrare/**/*.py"), *ROOT.glob("plugins/*/src/**/*.py")]
    kinds = {kind for path in sources for kind in re.findall(r'\bNote\(\s*"(\w+)"', path.read_text())}
    assert {case.split()[0] for case in MAKERS} == kinds
    table = PAGE.read_text(encoding="utf-8").partition("| kind | the note says |")[2]
    assert set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| ([^|]*) \|", table, re.MULTILINE)))) == kinds


@pytest.mark.parametrize("case", MAKERS)
def test_notes_are_complete_sentences(case):
    notes = make(case).notes
    assert case.split()[0] in {note.kind for note in notes}
    assert len(set(notes)) == len(notes)
    for note in notes:
        assert note.text[0].isupper()
        assert note.text.endswith(".")
        assert not note.text.endswith("..")


@pytest.mark.parametrize("show", RENDERERS)
@pytest.mark.parametrize("case", MAKERS)
def test_each_renderer_shows_every_note(case, show, tmp_path, capsys):
    result = make(case)
    shown = show(result, tmp_path, capsys)
    assert [note.text for note in result.notes if shown.count(note.text) != 1] == []


@pytest.mark.parametrize("show", RENDERERS)
def test_each_renderer_shows_the_reply_of_the_outlier_probe(show, tmp_path, capsys):
    result = make_missed()
    text = result.health["outliers"]
    assert "one number of `noise 1` far in its tail at the start" in text
    assert show(result, tmp_path, capsys).count(text) == 1


@cache
def make_missed():
    options = {"runs": 20, "particles": 20, "discard": 2, "grow": False}
    task = problem(4.5, Starts(scale=STEPS**-0.5))
    results = (avrare.estimate(task, "ams", seed=seed, **options) for seed in range(20))
    return next(result for result in results if "outliers" in result.health)


@pytest.mark.parametrize("case", MAKERS)
def test_notes_are_stored_and_read_back(case):
    result = make(case)
    stored = json.loads(result.to_json())
    assert stored["notes"] == [vars(note) for note in result.notes]
    assert StoredEstimate.model_validate(stored).notes == list(result.notes)


def test_a_note_counts_the_events_of_the_whole_estimate():
    result = estimate("auto", problem(0.5, Solved()), rollouts=5000)
    assert result.counts["solves"] > 400 * result.diagnostics["choice"]["counting_rollouts"]
    texts = [note.text for note in result.notes if note.kind == "counts"]
    solves, fallbacks = result.counts["solves"], result.counts["fallback_solves"]
    assert texts == [
        f"Counted: fallback solves {fallbacks:,} of {solves:,} solves.",
        f"Counted: skipped frames {result.counts['skipped_frames']:,}.",
    ]
