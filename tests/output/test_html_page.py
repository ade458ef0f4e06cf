"""The report as a file: whole, safe, and honest about what it cannot show; and its templates."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import Markup

from avrare.analysis.page.build import build_report
from avrare.analysis.page.model import ReportModel
from avrare.base.number_format import format_amount_in_words, format_typeset
from avrare.cli.main import main
from avrare.output.html.page import load_templates, render_page
from avrare.output.report import render_report
from avrare.plugin.registry import default_registry
from avrare.results.run import Run


def first_card(html):
    return html[html.index('id="verdict"') : html.index('id="estimates"')]


def films(html):
    found = re.findall(r'<script type="application/json">(.*?)</script>', html, flags=re.S)
    return [json.loads(one) for one in found]


def test_the_report_is_one_file_that_loads_nothing(made):
    html = render_report(made)
    assert not re.findall(r"https?://|@import|url\(", html)
    assert all(one.startswith("data:image/png;base64,") for one in re.findall(r'src="([^"]*)"', html))
    assert not re.findall(r"<link|<iframe|<object", html)
    assert "default-src &#39;none&#39;" in html


@pytest.mark.parametrize("which", ["made", "split"])
def test_a_model_read_from_json_renders_the_same_page(which, request):
    model = build_report(Run.read(request.getfixturevalue(which)))
    stored = model.to_json()
    assert render_page(ReportModel.from_json(stored)) == render_page(model)
    assert len(json.loads(stored)["sections"][0]["players"]) == len(model.sections[0].players) > 0


@pytest.mark.slow
def test_a_model_of_drives_read_from_json_renders_the_same_page(lane_change):
    model = build_report(Run.read(lane_change))
    assert model.sections[0].players[0].view["road"]
    assert render_page(ReportModel.from_json(model.to_json())) == render_page(model)


def test_numbers_that_are_not_finite_are_read_back(made):
    model = build_report(Run.read(made))
    first, *others = model.sections
    first = replace(first, estimate=replace(first.estimate, seconds=math.inf))
    model = replace(model, sections=(first, *others))
    assert ReportModel.from_json(model.to_json()) == model


def test_every_estimate_is_in_the_table(made):
    html = render_report(made)
    html = html[html.index('id="estimates"') :]
    for entry in json.loads((made / "result.json").read_text())["estimates"]:
        row = html[html.index(f'href="#specification-{0 if entry["specification"] == "left" else 1}"') :]
        row = row[: row.index("</tr>")]
        assert f"<strong>{format_typeset(entry['probability'])}</strong>" in row
        assert f"{entry['failures']:,}" in row
        assert f"interval from {format_typeset(entry['interval'][0], 2)} to" in row
    assert "Passes" in html
    assert "&lt; 0.9" in html


def test_the_first_lines_say_whether_each_threshold_holds(plane, tamper):
    summary = first_card(render_report(plane))
    assert "The threshold holds." in summary
    assert "; allowed is less than 90 %: it holds." in summary
    estimates = json.loads((plane / "result.json").read_text())["estimates"]
    known = [("fail", 0.002, 0.004), ("inconclusive", 0.0005, 0.02)]
    for entry, (verdict, low, high) in zip(estimates, known, strict=True):
        entry |= {"verdict": verdict, "probability": (low * high) ** 0.5, "interval": [low, high]}
    tamper(plane, "result.json", estimates=estimates)
    text = (plane / "scenario.yaml").read_text()
    bound = "- specification: slow\n  probability: < 1e-3\n  confidence: 0.95\n"
    assert "thresholds:\n- specification: left\n  probability: < 0.9\n" in text
    (plane / "scenario.yaml").write_text(text.replace("thresholds:\n", f"thresholds:\n{bound}"))
    summary = first_card(render_report(plane))
    assert "0 of 2 thresholds hold, 1 is exceeded, 1 is undecided." in summary
    assert "broken in 1 in 350 rollouts of 2 s (1 in 500 to 1 in 250, 95 % confidence)" in summary
    assert "allowed is less than 1 in 1,000: undecided" in summary


def test_without_thresholds_the_report_says_how_to_set_one(plane, tamper):
    estimates = json.loads((plane / "result.json").read_text())["estimates"]
    tamper(plane, "result.json", estimates=[{**one, "verdict": None} for one in estimates])
    summary = first_card(render_report(plane))
    assert "No threshold is set, so there is no verdict" in summary
    assert "thresholds: [{specification: left, probability: &#34;&lt; 1e-3&#34;}]" in summary


def test_a_known_exposure_gives_rates(plane):
    text = (plane / "scenario.yaml").read_text()
    exposure = "exposure: {count: 40, hours: 500.0}\n"
    (plane / "scenario.yaml").write_text(text + exposure)
    summary = first_card(render_report(plane))
    p = json.loads((plane / "result.json").read_text())["estimates"][0]["probability"]
    assert f"On the road: once in {format_amount_in_words(1 / (40 / 500 * p))} hours (" in summary
    assert "This scene is met 0.08 times per hour (0.058 – 0.11), counted 40 times." in summary


def test_rules_stand_in_words_beside_their_formulas(made):
    html = render_report(made)
    assert "At all times, x is below 1." in html
    assert "always (x &lt; 1.0)" in html


def test_the_worst_and_the_most_likely_failure_are_replayed(made):
    html = render_report(made)
    with np.load(made / "failures.npz") as stored:
        robustness, noise = stored["left.robustness"], stored["left.noise"]
    least = np.sqrt(np.square(noise).sum(axis=(1, 2)).min())
    section = html[html.index('id="specification-0"') : html.index('id="specification-1"')]
    assert f"robustness {robustness.min():.3g} ".replace("-", "−") in section
    assert f"norm of the noise {least:.3g} " in section
    assert "Its robustness is now" not in section
    assert len(films(section)) == 2
    assert films(section)[0] == {"dt": 0.1, "samples": 21}
    assert "Signal x over time" in section


def test_without_its_plugins_the_report_gives_the_reason(made, monkeypatch):
    monkeypatch.setenv("AVRARE_PLUGINS", "none")
    default_registry.cache_clear()
    try:
        html = render_report(made)
    finally:
        default_registry.cache_clear()
    assert "The scenario of this run cannot be built here" in html
    assert "provided by avrare-linear" in html
    assert "Histogram of the robustness of 400 rollouts" in html
    assert not films(html)


@pytest.mark.slow
def test_a_replay_has_its_road_vehicles_and_observations(lane_change):
    html = render_report(lane_change)
    film = films(html)[0]
    assert film["samples"] == 40
    assert {one["name"] for one in film["others"]} == {"parked", "cut_in", "merge"}
    assert len(film["road"]["lanes"]) == 3
    assert film["seen"][0] is None
    assert len(film["seen"][1]) == 3
    assert len(film["plan"][1]) > 5
    assert len(film["predicted"][1]) == 3
    assert "perception of cut_in" in html
    for caption in ("Error of cut_in as seen [m]", "Distance to ", "Speed [m/s]", "Acceleration of", "Jerk"):
        assert caption in html
    lost = re.findall(r">Lost at t = [\d.]+ s: with", html)
    assert html.count("Robustness if the noise ended here") == len(lost)
    assert len(html) < 3_000_000


def test_the_file_is_written_where_requested(made, tmp_path, capsys):
    assert main(["report", str(made), "--out", str(tmp_path / "new")]) == 0
    assert (tmp_path / "new" / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert "new/report.html" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("result.json", None, "no result.json in it"),
        ("result.json", "{", "cannot be read"),
        ("rollouts.npz", "no zip", "cannot be read"),
    ],
)
def test_damaged_folders_are_a_clear_error(plane, capsys, name, content, message):
    (plane / name).unlink() if content is None else (plane / name).write_text(content)
    assert main(["report", str(plane)]) == 4
    assert message in capsys.readouterr().err


def test_a_folder_of_several_runs_names_them(made, capsys):
    assert main(["report", str(made.parent)]) == 4
    assert "it holds several runs; give one of them: run" in capsys.readouterr().err
    assert main(["report", str(made), "--out", str(made / "result.json")]) == 4
    assert "result.json/report.html: cannot write" in capsys.readouterr().err


def test_each_number_leads_to_its_command(made):
    html = render_report(made)
    assert html.count('href="#command-run"') == 4  # verdict, estimates, two specifications
    at = html.index('id="command-run"')
    assert f"avrare run {made / 'scenario.yaml'}" in html[at : at + 300]
    for index in range(2):
        assert f'href="#specification-{index}"' in html[html.index("<nav") : html.index("</nav>")]
    anchors = set(re.findall(r' id="([^"]+)"', html))
    assert set(re.findall(r' href="#([^"]+)"', html)) <= anchors
    assert re.search(r"avrare replay --run \S+ --specification left --failure \d+ --lost", html)


def render(source, **values):
    return load_templates().from_string(source).render(values)


def test_text_and_attributes_are_escaped_and_markup_is_not():
    values = {"a": "q\"'", "b": "a < b & c", "c": Markup("<b>x</b>")}
    found = render('<p class="{{ a }}">{{ b }}{{ c }}{{ 3 }}</p>', **values)
    assert found == '<p class="q&#34;&#39;">a &lt; b &amp; c<b>x</b>3</p>'


def test_a_name_cannot_command_a_terminal_or_turn_the_text_around():
    found = render('<p title="{{ a }}">{{ b }}</p>', a="\x07", b="\x1b[31mred\u202e\n")
    assert found == '<p title="\\x07">\\x1b[31mred\\u202e\n</p>'


def test_names_that_are_joined_or_made_a_part_of_text_are_escaped():
    source = '{{ several | join(" · ") }} {{ name | replace("_", " ") }}'
    found = render(source, several=["<", "\x07"], name="<_")
    assert found == "&lt; · \\x07 &lt; "


def test_no_text_ends_a_block_of_data():
    block = render("{{ it | data | safe }}", it={"name": "</script><script>alert(1)"})
    assert "<" not in block
    assert json.loads(block) == {"name": "</script><script>alert(1)"}
    with pytest.raises(ValueError, match="JSON"):
        render("{{ it | data | safe }}", it=math.nan)


def test_line_ends_and_indents_of_a_template_are_no_part_of_the_page():
    assert render("<ul>\n  <li>{{ a }}</li>\n</ul>\n", a="x\n  y") == "<ul><li>x\n  y</li></ul>"
