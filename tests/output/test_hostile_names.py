"""Names from strangers in every document and every screen: none is obeyed by what shows it."""

import csv
import io
import json
import re
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

import avrare
from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.analysis.check.power_analysis import CostEstimate
from avrare.analysis.compare.case import ComparisonCase, GroundTruth
from avrare.analysis.compare.comparison import ArmResult, Comparison, StudyDesign
from avrare.analysis.compare.estimator_options import parse_arms
from avrare.analysis.compare.paired_comparison import PairedComparison
from avrare.analysis.compare.version_changes import PairedCounts
from avrare.analysis.monitor.cause_finder import DecisiveSample
from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.base.errors import UsageError
from avrare.cli.output import print_warnings, say
from avrare.driving import Road
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Info
from avrare.estimation.result.note import describe_counts
from avrare.output import documents
from avrare.output.plots.estimate_plots import plot_comparison
from avrare.output.plots.monitoring_plot import plot_monitoring
from avrare.output.report import render_report
from avrare.output.terminal import comparison_table, result_table
from avrare.output.terminal.check_table import print_check, print_plan
from avrare.output.terminal.console import make_console, print_lines, print_table
from avrare.output.terminal.progress_line import Progress
from avrare.plugin.registry import default_registry
from avrare.results.recordings import Recording, VehicleTrack, assemble_recording
from avrare.testing.problems import walk
from avrare_recordings.formats.commonroad import to_commonroad
from avrare_recordings.formats.csv_recording import read_csv, to_csv
from avrare_recordings.output import monitoring_documents, monitoring_text
from plain_results import plain_result

NAMES = {
    "escape": "\x1b]0;owned\x07\x1b[2J",
    "one-byte escape": "\x9b31mred",
    "direction": "\u202egnp.exe",
    "rich": "[red]x[/red] [link=http://x]y[/link] [/]",
    "html": "</script><script>alert(1)</script><img src=x onerror=alert(1)>",
    "attribute": "\" onload='alert(1)' x=\"",
    "equals": '=HYPERLINK("http://x","y")',
    "plus": "+1+cmd|' /C calc'!A0",
    "minus": "-2+3",
    "at": "@SUM(1)",
    "spaces first": " \t=1+1",
    "markdown": "a | b `c` ![i](http://x) [l](javascript:alert(1)) **b** <b> #1 @all",
    "fence": "```\n# heading\n",
    "line": "fine\nverdict: pass\r\n| pass |",
    "xml": "]]> <!ENTITY x SYSTEM 'file:///etc/passwd'> &x; \x00 \ud800 \ufffe",
    "formula": r"$\frac{$ \$ $x_$",
}
OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


@pytest.fixture(params=NAMES.values(), ids=NAMES)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def problem():
    return walk(3.8, 5).problem()


@pytest.fixture(scope="module")
def estimate(problem):
    return avrare.estimate(problem, "mc", rollouts=50, seed=1)


def results_of(name, estimate):
    health = {name: name, "errors": name}
    return [replace(estimate, specification=name, health=health, notes=describe_counts({name: 3}))]


def check_of(name, estimate):
    verdicts = "pass", "fail", "inconclusive"
    rows = [Decision(name, name, "threshold", name, one, name, 0.01, (0.0, 0.1)) for one in verdicts]
    return CheckResult(tuple(rows), {name: tuple(results_of(name, estimate))}, notes=(name,))


def comparison_of(name, problem):
    (arm,) = parse_arms("mc", [], None, default_registry())
    runs = (plain_result(failures=3, interval=(0.05, 0.2), health={name: name}),) * 3
    entries = ArmResult(replace(arm, label=name), runs), ArmResult(arm, refusal=UsageError(name))
    design = StudyDesign(Budget("steps", 1e6), repeat=3)
    return Comparison(ComparisonCase(name, name, problem), design, entries, GroundTruth(0.1, name))


def paired_of(name):
    resolved = [{"specifications": {name: rule}, "simulator": rule} for rule in "ab"]
    first, second = (
        SimpleNamespace(confidence=0.95, blocks={}, cheap=None, resolved=one) for one in resolved
    )
    counts = PairedCounts(name, 1, 2, 3, 4, 1)
    return PairedComparison((name, name), (first, second), (counts,), 11, 0)


def drive_of(name):
    present = np.ones(3, dtype=bool)
    states = np.array([np.arange(3.0), np.zeros(3), np.zeros(3), np.ones(3), np.zeros(3)])
    tracks = [VehicleTrack(one, 4.5, 1.8, present, states + k) for k, one in enumerate(("ego", name))]
    return assemble_recording(name, 0.1, 0.0, tracks[0], tracks[1:], Road((0.0, 3.5), 3.5))


def monitored_of(name, recording):
    decisive = DecisiveSample(1, -1.0, {"o": name}, f"{name} > 0", -1.0, 1)
    prefix = np.array([1.0, -1.0, -1.0])
    return MonitoringResult(
        name=name, formula=name, recording=recording, prefix=prefix, prefix_violated=prefix < 0, body=prefix,
        first=decisive, worst=decisive, excluded=(name,),
    )  # fmt: skip


def screens(name, problem, estimate):
    """Show the name wherever a terminal can show one."""
    results, check = results_of(name, estimate), check_of(name, estimate)
    comparison, paired = comparison_of(name, problem), paired_of(name)
    monitored = monitored_of(name, drive_of(name))
    console = make_console()
    for mode in ("auto", "plain", "quiet"):
        print_check(check, mode)
    print_plan([CostEstimate(name, name, name, 1, 2, 3.0, name)])
    print_table(console, result_table.result_table(name, results))
    for lines in (result_table.warning_lines, result_table.note_lines):
        print_lines(console, lines(results), "yellow")
    say(*result_table.verdict_lines(name, results))
    for one, table in (
        (comparison, comparison_table.comparison_table(comparison)),
        (paired, comparison_table.paired_table(paired)),
    ):
        print_table(console, table)
        print_lines(console, one.lines())
    for line in (*monitoring_text.headline(monitored), *monitoring_text.draw_chart(monitored)):
        console.print(line)
    with Progress(name, problem, "plain") as progress:
        progress.printed = -1e9
        progress(Info(rollouts=3, counts={name: 2}))
    print_warnings([(name, name)])
    say(*UsageError(name, name).lines(), error=True)


def test_a_terminal_obeys_none(name, problem, estimate, capsys, monkeypatch):
    screens("plain", problem, estimate)
    honest = capsys.readouterr()
    screens(name, problem, estimate)
    shown = capsys.readouterr()
    for before, after in ((honest.out, shown.out), (honest.err, shown.err)):
        assert "plain" in before
        assert not OBEYED.search(after)
    assert "[/]" not in name or "[/]" in shown.out  # shown as it is, not taken for markup


def test_a_terminal_with_colours_gets_only_those_of_avrare(name, problem, estimate, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    screens(name, problem, estimate)
    shown = capsys.readouterr().out
    assert "\x1b[" in shown
    rest = re.sub(r"\x1b\[[0-9;]*m", "", shown)  # colours
    assert not OBEYED.search(rest)
    assert "\x1b]8;" not in shown  # links


class Elements(HTMLParser):
    """Elements and attributes that run or load something."""

    def __init__(self):
        super().__init__()
        self.found, self.active = [], []

    def handle_starttag(self, tag, attributes):
        self.found += [tag] if tag in ("script", "img", "link", "iframe") else []
        self.active += [key for key, _ in attributes if key.startswith("on") or key in ("src", "srcset")]


def structure(html):
    parser = Elements()
    parser.feed(html)
    return parser.found, parser.active


def test_the_report(plane, tamper, name):
    text = name.encode("utf-8", "replace").decode()
    honest = structure(render_report(plane))
    result = json.loads((plane / "result.json").read_text())
    for one in result["estimates"]:
        one["estimator"] = one["estimator"] + text
        one["notes"] = [{"kind": "cause", "text": text}]
    versions = {**result["versions"], text: text}
    tamper(plane, "result.json", scenario=text, estimates=result["estimates"], versions=versions)
    tamper(plane, "provenance.json", command=["avrare", text], commit=text, python=text, budget=text)
    page = render_report(plane)
    assert structure(page) == honest
    assert not OBEYED.search(page)


def test_junit(name, estimate):
    text = documents.junit(check_of(name, estimate))
    assert not OBEYED.search(text)
    assert "<!" not in text
    top = ElementTree.fromstring(text.encode())
    assert [len(suite) for suite in top] == [3]


def test_markdown(name, problem, estimate):
    for made in (documents.markdown, comparison_table.markdown):
        is_check = made is documents.markdown
        show = partial(check_of, estimate=estimate) if is_check else partial(comparison_of, problem=problem)
        honest, text = made(show("plain")), made(show(name))
        assert not OBEYED.search(text)
        assert shape(text) == shape(honest)


def test_github_annotations(name, estimate):
    """Write each in one line, and none as another command of a workflow."""
    path = name.replace("\0", "").replace("\ud800", "")
    lines = documents.annotate_rows(check_of(name, estimate), {name: path})
    assert [line.split()[0] for line in lines] == ["::error", "::warning"]
    assert not OBEYED.search("".join(lines))
    assert not re.search("[\n\r]", "".join(lines))


def shape(text):
    """Return the kind of each line of Markdown, its columns, and what would be rendered as more than text."""
    bare = re.sub(r"`[^`\n]*`", "code", re.sub(r"\\.", "", text))
    kinds = [(line[:1] if line[:1] in "#-|" else "text", line.count("|")) for line in bare.splitlines()]
    return kinds, re.findall(r"[<\[`]", bare)


def cells(text):
    return [cell for row in csv.reader(io.StringIO(text)) for cell in row]


def is_formula(cell):
    try:
        float(cell)
    except ValueError:
        return cell.lstrip()[:1] in tuple("=+-@")
    return False


def test_csv(name, tmp_path):
    signals = Recording("r", 0.1, 0.0, {name: np.zeros(3), "y": np.ones(3)})
    path = tmp_path / "monitor.csv"
    monitoring_documents.write_monitoring_csv(monitored_of(name, signals), path)
    for text in (to_csv(drive_of(name)), to_csv(signals), path.read_text()):
        assert not OBEYED.search(text)
        assert not [cell for cell in cells(text) if is_formula(cell)]
    path.write_bytes(to_csv(drive_of(name)).encode("utf-8", "replace"))
    assert len(read_csv(str(path), road=Road((0.0, 3.5), 3.5)).names) == 1


def test_json(name, problem, estimate):
    contents = [
        documents.comparison_document(comparison_of(name, problem)),
        monitoring_documents.monitoring_document(monitored_of(name, drive_of(name))),
        results_of(name, estimate)[0].to_dict(),
    ]
    for content in contents:
        text = json.dumps(content)
        assert text.isascii()
        assert not OBEYED.search(text.replace("\x7f", ""))
        assert json.loads(text) == json.loads(json.dumps(content))


def test_commonroad(name):
    text = to_commonroad(drive_of(name), name)
    assert not OBEYED.search(text)
    assert ElementTree.fromstring(text.encode()).tag == "commonRoad"


@pytest.mark.parametrize("name", [NAMES[kind] for kind in ("formula", "xml", "line")])
def test_plots(name, problem, tmp_path):
    path = tmp_path / "plot.png"
    drive = drive_of(name)
    plot_comparison(comparison_of(name, problem)).save(path)
    plot_monitoring(monitored_of(name, drive)).save(path)
    assert path.read_bytes()[:4] == b"\x89PNG"
