"""Results in a Python session: text, tables, traces, plots, reports, progress."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.base.number_format import format_interval, format_probability
from avrare.testing import faulty_systems as systems


def walk(*bounds):
    formulas = {f"below_{bound}": avrare.stl(f"always (x < {bound})") for bound in bounds}
    return avrare.Problem(systems.Walk(), formulas, steps=40)


@pytest.fixture(scope="module")
def several():
    return avrare.estimate_all(walk(1.0, 1.5), rollouts=500, seed=3)


@pytest.fixture(scope="module")
def split():
    return avrare.estimate(walk(1.5), "ams", particles=40, discard=8, runs=3, seed=1)


def test_a_result_is_one_readable_line(split):
    numbers = f"{format_probability(split.probability)} ({format_interval(split.interval)})"
    assert repr(split).startswith(f"<Result below_1.5: {numbers}, ams, ")
    assert "\n" not in repr(split)
    assert "few_roots" in repr(replace(split, health={"few_roots": "a reason"}))


def test_table_is_plain_rows(several):
    rows = several.table()
    assert [row["specification"] for row in rows] == list(several)
    assert rows[0]["low"] <= rows[0]["probability"] <= rows[0]["high"]
    assert json.loads(json.dumps(rows)) == [{**row, "warnings": []} for row in rows]
    assert repr(rows).splitlines()[0].split()[:2] == ["specification", "estimator"]
    assert "below_1.5" in rows._repr_html_()


def test_table_becomes_a_data_frame(several):
    frame = several.table().frame()
    assert frame["probability"].tolist() == [one.probability for one in several.values()]


def test_trace_is_the_replay_of_a_tape(split):
    trace = split.trace()
    assert (trace.outcome, trace.robustness) == ("fails", split.worst.robustness)
    assert trace["x"].shape == (41,)
    assert trace.robustness == pytest.approx(1.5 - trace["x"].max())
    assert trace.times.tolist() == list(range(41))
    assert [row["x"] for row in trace.table()] == trace["x"].tolist()
    assert split.trace(0).robustness == split.failures.robustness[0]


def test_trace_takes_a_problem_with_a_tape_or_a_result_with_a_number(split):
    problem = walk(1.5)
    assert avrare.trace(problem, split.worst.noise).robustness == split.worst.robustness
    assert avrare.trace(split, split.worst.noise).robustness == avrare.trace(split).robustness
    assert avrare.trace(split, 1).robustness == split.failures.robustness[1]
    assert avrare.trace(problem).outcome == "passes"
    assert (avrare.trace(problem)["x"] == 0.0).all()
    assert avrare.trace(walk(1.0, 1.5), specification="below_1.5").specification == "below_1.5"
    with pytest.raises(avrare.UsageError, match="specification"):
        avrare.trace(walk(1.0, 1.5))
    with pytest.raises(avrare.UsageError, match="failure 0 of a problem"):
        avrare.trace(problem, 0)


@pytest.mark.parametrize(
    ("noise", "message"), [(np.zeros((40, 1)), r"shape \(40, 1\)"), (np.zeros((2, 41, 1)), "one tape, not 2")]
)
def test_trace_refuses_what_does_not_fit(noise, message):
    with pytest.raises(avrare.UsageError, match=message):
        avrare.trace(walk(1.5), noise)


def test_plots_are_pictures(split, several, tmp_path):
    for plot in (split.plot(), several.plot(), split.trace().plot(), split.trace().plot(["x"])):
        assert plot._repr_png_().startswith(b"\x89PNG")
    assert split.plot().save(tmp_path / "plot.svg").read_text().lstrip().startswith("<?xml")
    with pytest.raises(avrare.UsageError, match="no signal 'y'"):
        split.trace().plot(["y"])


def test_report_shows_the_failure_and_how_to_make_it_again(split, tmp_path):
    text = split.report(tmp_path / "new" / "report.html").read_text(encoding="utf-8")
    assert "avrare.estimate(problem, &#34;ams&#34;, seed=1, particles=40, discard=8, runs=3)" in text
    assert "Worst failure" in text
    assert "always (x &lt; 1.5)" in text
    assert "cannot be built" not in text


def test_a_pickled_result_has_lost_its_problem_and_says_so(split):
    copy = pickle.loads(pickle.dumps(split.origin and replace(split, interval_at=_interval)))
    with pytest.raises(avrare.UsageError, match="does not know its problem"):
        copy.trace()
    with pytest.raises(avrare.UsageError, match="does not know its problem"):
        copy.report("nowhere.html")


def _interval(confidence):
    return 0.0, 1.0


OF_A_PATH = ("run", "rate", "validate", "check", "why", "replay", "monitor", "report")


@pytest.mark.parametrize("name", [*OF_A_PATH, "falsify", "trace"])
@pytest.mark.parametrize("value", [None, 3.0, b"scenario.yaml", ["scenario.yaml"]])
def test_what_is_no_path_is_refused_by_its_type(name, value):
    with pytest.raises(avrare.UsageError, match=f"is needed, not {type(value).__name__}") as caught:
        getattr(avrare, name)(value)
    assert caught.value.hint


@pytest.mark.parametrize("name", OF_A_PATH)
def test_a_problem_in_place_of_a_path_is_refused(name):
    with pytest.raises(avrare.UsageError, match="is needed, not Problem"):
        getattr(avrare, name)(walk(1.0))


@pytest.mark.parametrize("value", ["runs/a", None, 3.0])
def test_a_plot_of_something_else_is_refused(value):
    with pytest.raises(avrare.UsageError, match=f"a {type(value).__name__} has no plot"):
        avrare.plot(value)
