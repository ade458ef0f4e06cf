"""``avrare check`` as a user and a CI server meet it."""

import json
import os
import signal
from pathlib import Path
from xml.etree import ElementTree

import pytest

from avrare.cli.main import main
from avrare.output.terminal.progress_line import Progress

BOUND = "thresholds: [{specification: in_lane, probability: '< %s'}]\n"


def verdicts(content):
    return {(row["specification"], row["kind"]): row["verdict"] for row in content["rows"]}


@pytest.mark.parametrize(
    ("bound", "code", "verdict"), [("0.1", 0, "pass"), ("0.02", 1, "fail"), ("0.0505", 3, "inconclusive")]
)
def test_a_threshold_becomes_an_exit_code(drive, check, bound, code, verdict):
    found, content = check(drive(BOUND % bound))
    assert (found, content["exit_code"], content["verdict"]) == (code, code, verdict)
    assert verdicts(content) == {("in_lane", "threshold"): verdict}
    (row,) = content["rows"]
    assert row["interval"][0] < 0.05 < row["interval"][1]
    assert not Path("baselines").exists()


ASSUMING = """\
specifications: {in_lane: {stl: "always (offset < 3.5)"}}     # p = 2.3e-4
estimator: {plugin: is}
thresholds: [{specification: in_lane, probability: "< 5e-4"}]
"""


def test_a_search_holds_as_far_as_it_could_see(drive, check, capsys):
    path = Path(drive())
    head = path.read_text().partition("specifications:")[0]
    path.write_text(head + ASSUMING)
    code, content = check("drive.yaml")
    (row,) = content["rows"]
    assert (code, row["verdict"]) == (0, "pass_assuming")
    reason = "holds as far as the search could see; failures that nothing led to could be up to "
    assert row["reason"].startswith(reason)
    assert "rollouts of Monte Carlo would settle it" in row["next_step"]
    assert content["results"][0]["estimates"][0]["verdict"] == "pass_assuming"
    assert check("drive.yaml", "--strict")[0] == 3
    assert main(["run", "drive.yaml", "--out", "seen", "--plain"]) == 0
    assert main(["report", "seen"]) == 0
    assert "pass_assuming" in capsys.readouterr().out
    page = Path("seen/report.html").read_text()
    assert "The threshold holds as far as the search could see." in page
    assert "nothing led to could be up to 1 in" in page
    path.write_text(head + ASSUMING.replace('5e-4"', '5e-4", blind: counted'))
    code, content = check("drive.yaml")
    (row,) = content["rows"]
    assert (code, row["verdict"], row["question"]) == (3, "inconclusive", "< 5e-4, blind counted")
    assert "could be up to" in row["reason"]


def test_the_first_run_is_saved_and_the_next_is_compared(drive, check):
    code, content = check(drive())
    assert code == 0
    assert any("0001.json; commit it" in note for note in content["notes"])
    assert any("on_road: no failures: the change is not known" in note for note in content["notes"])
    saved = json.loads(Path("baselines/drive/0001.json").read_text())
    assert [one["specification"] for one in saved["estimates"]] == ["in_lane", "on_road"]
    code, content = check("drive.yaml", "--seed", "5")
    assert code == 0
    assert verdicts(content) == {("in_lane", "regression"): "pass", ("on_road", "regression"): "pass"}
    assert "the change is not known, at most 0.0018 here" in content["rows"][1]["reason"]
    assert len(list(Path("baselines/drive").iterdir())) == 1
    assert check("drive.yaml", "--seed", "6", "--save")[0] == 0
    assert len(list(Path("baselines/drive").iterdir())) == 2


def test_a_worse_driver_fails_and_a_better_one_passes(drive, check):
    check(drive())
    code, content = check("drive.yaml", "--seed", "1", "--set", "controller.skill=0.75")
    assert code == 1
    row = content["rows"][0]
    assert row["verdict"] == "fail"
    assert row["change_interval"][0] > 1.0
    assert "times the baseline" in row["reason"]
    assert check("drive.yaml", "--seed", "1", "--set", "controller.skill=1.3")[0] == 0


@pytest.mark.slow
def test_small_steps_are_compared_with_the_first_baseline_too(drive, check):
    words = [drive(), "--set", "estimator.specifications=[in_lane]", "--save"]
    assert check(*words)[0] == 0
    assert check(*words, "--set", "controller.skill=0.93")[0] == 0  # 0.063 for 0.05
    code, content = check(*words, "--set", "controller.skill=0.87")  # 0.077
    rows = {row["question"]: row for row in content["rows"]}
    assert (code, rows["<= baseline"]["verdict"], rows["<= first baseline"]["verdict"]) == (1, "pass", "fail")
    # Accepted with --accept-changes, it begins a line of its own.
    assert check(*words, "--set", "controller.skill=0.87", "--accept-changes")[0] == 0
    _, content = check(*words[:3], "--set", "controller.skill=0.87")
    assert [row["question"] for row in content["rows"]] == ["<= baseline"]


def test_a_baseline_of_another_problem_is_refused_unless_accepted(drive, capsys):
    assert main(["check", drive()]) == 0
    assert main(["check", "drive.yaml", "--set", "simulator.dt=0.05", "--set", "steps=2"]) == 4
    error = capsys.readouterr().err
    assert "steps 1 -> 2, simulator.dt 0.1 -> 0.05" in error
    assert "compare anyway with --accept-changes" in error
    assert main(["check", "drive.yaml", "--set", "simulator.dt=0.05", "--accept-changes"]) == 0
    assert "although the problem changed" in capsys.readouterr().out


def test_a_threshold_of_a_rule_that_is_not_estimated_does_not_pass(drive, check):
    code, content = check(drive(BOUND % 0.1), "--set", "estimator.specifications=[on_road]")
    assert code == 3
    assert "leaves it out" in content["rows"][0]["reason"]


def test_rollout_errors_have_their_own_exit_code(drive, check):
    words = ["--set", "simulator.breaks=1.5", "--junit", "report.xml"]
    code, content = check(drive(BOUND % 0.5), *words)
    assert code == 6
    assert verdicts(content) == {("in_lane", "threshold"): "inconclusive"}
    assert ElementTree.parse("report.xml").find(".//testcase/error") is not None
    assert check(drive(BOUND % 0.5), *words, "--set", "max_error_rate=0.2")[0] == 0


def test_the_cause_of_rollout_errors_is_told_without_thresholds_too(drive, check):
    words = ["--set", "simulator.breaks=0.5"]  # many rollouts
    for more, saved in (([], "none was saved"), (["--save"], "saved, with")):
        code, content = check(drive(), *words, *more)
        assert code == 6
        for row in content["rows"]:
            assert saved in row["reason"]
            assert row["reason"].endswith("1.0% allowed: fault reported by the system")


def test_a_health_warning_prevents_a_pass_and_a_first_baseline(drive, check):
    words = [drive(), "--set", "estimator.specifications=[on_road]", "--estimator", "ams"]
    words += [
        "--set",
        "estimator.particles=4",
        "--set",
        "estimator.discard=1",
        "--set",
        "estimator.floor=0.1",
    ]
    code, content = check(*words)
    assert code == 3
    assert "extinct" in content["rows"][0]["reason"]
    assert not Path("baselines").exists()
    code, content = check(*words, "--save")
    assert code == 3
    assert Path("baselines/drive/0001.json").exists()


def test_spending_continues_until_every_row_is_decided(drive, check):
    clear, content = check(drive(BOUND % 0.2), "--looks", "--budget", "rollouts=8000")
    assert (clear, content["looks"]) == (0, 1)
    assert content["results"][0]["estimates"][0]["rollouts"] == 1000
    unclear, content = check(drive(BOUND % 0.05), "--looks", "--budget", "rollouts=8000")
    assert (unclear, content["looks"]) == (3, 4)
    entry = content["results"][0]["estimates"][0]
    assert entry["rollouts"] == entry["simulated_steps"] == 8000
    narrow = content["rows"][0]["interval"]
    assert narrow[1] - narrow[0] < 0.022


def test_a_saved_baseline_takes_every_look(drive, check):
    _, content = check(drive(BOUND % 0.2), "--looks", "--budget", "rollouts=8000", "--save")
    assert content["looks"] == 4
    saved = json.loads(Path("baselines/drive/0001.json").read_text())
    assert saved["estimates"][0]["rollouts"] == 8000


def test_several_scenarios_share_one_error_rate(drive, check):
    words = [drive(BOUND % 0.1, "one"), drive(BOUND % 0.02, "two"), "--out", "results"]
    code, content = check(*words)
    assert code == 1
    assert [(row["scenario"], row["verdict"]) for row in content["rows"]] == [
        ("one", "pass"),
        ("two", "fail"),
    ]
    assert json.loads(Path("results/check.json").read_text()) == content
    for name, verdict in (("one", "pass"), ("two", "fail")):
        result = json.loads(Path(f"results/{name}/result.json").read_text())
        assert result["estimates"][0]["verdict"] == verdict
    assert main(["check", words[0], words[1], "--baseline", "kept"]) == 1
    assert {path.name for path in Path("kept").iterdir()} == {"one"}  # a failing run is no baseline


def test_the_table_and_the_report_files(drive, capsys):
    main(["check", drive()])
    capsys.readouterr()
    words = ["check", drive(BOUND % 0.0505), "--seed", "2", "--junit", "new/report.xml", "--markdown", "s.md"]
    assert main(words) == 3
    screen = capsys.readouterr().out
    for part in ("in_lane", "< 0.0505", "<= baseline", "inconclusive", "exit code 3", "use more rollouts"):
        assert part in screen
    assert "\x1b" not in screen
    assert "…" not in screen
    assert len(list(ElementTree.parse("new/report.xml").iter("testcase"))) == 3
    assert Path("s.md").read_text().startswith("### avrare check: ❔ inconclusive")


def test_a_plan_costs_little_and_exits_zero(drive, capsys):
    assert main(["check", drive(BOUND % 0.1), "--plan"]) == 0
    screen = capsys.readouterr().out
    assert "a pilot run of 200" in screen
    assert "no failures in 200 rollouts" in screen
    assert not Path("baselines").exists()
    assert main(["check", "drive.yaml", "--save"]) == 0
    capsys.readouterr()
    assert main(["check", "drive.yaml", "--plan", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)["plan"]
    prices = {(one["specification"], one["question"]): one["rollouts"] for one in plan}
    assert 150 <= prices["in_lane", "< 0.1"] <= 800
    assert 500 <= prices["in_lane", "<= baseline"] <= 3000
    assert 1500 <= prices["in_lane", "+-20 %"] <= 3500


def test_a_plan_for_auto_names_the_most_that_it_takes(drive, capsys):
    assert main(["check", drive(), "--plan", "--json", "--estimator", "auto"]) == 0
    plan = json.loads(capsys.readouterr().out)["plan"]
    rows = {row["specification"]: row for row in plan if row["question"] == "<= baseline"}
    assert 500 <= rows["in_lane"]["rollouts"] <= 3000
    assert rows["on_road"]["rollouts"] == 50_000
    assert rows["on_road"]["reason"] == "at most, to a relative error of 10.7 %, by a pilot run of 200"
    options = ["--set", "estimator={plugin: auto, relative_error: 0.05, rollouts: 20000}"]
    assert main(["check", "drive.yaml", "--plan", "--json", *options]) == 0
    (row,) = [
        row for row in json.loads(capsys.readouterr().out)["plan"] if row["specification"] == "on_road"
    ][:1]
    assert (row["rollouts"], row["reason"][:35]) == (20_000, "at most, to a relative error of 5 %")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--looks"], "several looks need a budget"),
        (["--looks", "--budget", "rollouts=4"], "divided into looks"),
        (["--set", "regression={ratio: 2, exclude: 1.5}"], "exclude (1.5) must be greater than ratio (2)"),
        (["--set", "regression.ratio=.inf"], "finite"),
        (["--junit", "."], "is a folder, not a file"),
        (["drive.yaml"], "two scenarios have the same name"),
    ],
)
def test_wrong_arguments_are_a_clear_error(drive, capsys, words, message):
    assert main(["check", drive(), *words]) == 4
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error


def test_a_baseline_that_is_required(drive, check, capsys):
    assert main(["check", drive(), "--require-baseline"]) == 4
    assert "baselines/drive: there is no baseline of 'drive'" in capsys.readouterr().err
    assert check("drive.yaml", "--baseline", "kept")[0] == 0
    assert check("drive.yaml", "--baseline", "kept", "--require-baseline")[0] == 0
    assert main(["check", "drive.yaml", "--baseline", "keept", "--require-baseline"]) == 4


def test_a_run_that_fails_a_threshold_does_not_become_the_first_baseline(drive, check):
    code, content = check(drive(BOUND % 0.02), "--baseline", "kept")
    reasons = {row["specification"]: row["reason"] for row in content["rows"] if row["kind"] == "regression"}
    assert code == 1
    assert "none was saved: it fails a threshold" in reasons["in_lane"]
    assert "none was saved: another specification" in reasons["on_road"]
    assert not Path("kept").exists()


def test_a_verdict_is_not_lost_with_a_baseline_that_cannot_be_saved(drive, check):
    Path("kept").write_text("a file where the folder should be")
    code, content = check(drive(BOUND % 0.1), "--baseline", "kept/here")
    assert code == 3
    assert verdicts(content)["in_lane", "threshold"] == "pass"
    assert verdicts(content)["in_lane", "regression"] == "inconclusive"
    assert "none was saved: the file could not be written" in content["rows"][-1]["reason"]
    assert any(
        "NOT saved: kept/here/0001.json: cannot save the baseline" in note for note in content["notes"]
    )


def test_quiet_prints_one_line_per_row_and_the_verdict(drive, capsys):
    assert main(["check", drive(BOUND % 0.1 + "confidence: 0.9\n"), "--quiet"]) == 0
    found = capsys.readouterr()
    assert found.out.splitlines()[0].startswith("drive in_lane < 0.1: pass, 0.0")
    assert found.out.splitlines()[1:] == ["pass, exit code 0"]
    assert found.err == ""
    assert main(["check", drive(BOUND % 0.02), "--quiet"]) == 1
    row, whole = capsys.readouterr().out.splitlines()
    assert row.startswith("drive in_lane < 0.02: fail, 0.0")
    assert row.count(": ") == 2  # and why
    assert whole == "fail, exit code 1"
    assert main(["check", "drive.yaml", "--quiet", "--plain"]) == 4


def test_an_earlier_result_is_not_overwritten(drive, capsys):
    words = ["check", drive(BOUND % 0.1), "--quiet", "--out", "results"]
    assert main(words) == 0
    before = {path: path.read_bytes() for path in Path("results").iterdir()}
    assert main([*words, "--seed", "3"]) == 4
    assert "results/check.json: contains the result of an earlier command" in capsys.readouterr().err
    Path("results/check.json").unlink()
    assert main(words) == 4
    assert "results/result.json" in capsys.readouterr().err
    del before[Path("results/check.json")]
    assert {path: path.read_bytes() for path in Path("results").iterdir()} == before
    two = ["check", drive(BOUND % 0.1, "one"), "drive.yaml", "--quiet", "--out", "results"]
    assert main(two) == 4
    assert "results/result.json" in capsys.readouterr().err
    Path("results/result.json").unlink()
    assert main(two) == 0
    assert Path("results/one/result.json").exists()


def test_an_interrupted_run_is_not_overwritten(drive, monkeypatch, capsys):
    from avrare.estimation.loop.checkpoint import Checkpoint

    monkeypatch.setattr(Checkpoint, "remove", lambda self: None)  # as if it had been killed at its end
    assert main(["run", drive(BOUND % 0.1), "--quiet", "--out", "results"]) == 0
    Path("results/result.json").unlink()
    assert main(["check", "drive.yaml", "--out", "results"]) == 4
    error = capsys.readouterr().err
    assert "contains an interrupted run" in error
    assert "resume with avrare run --out results --resume" in error


def test_sigterm_ends_a_check_as_it_ends_a_run(drive, monkeypatch, capfd):
    monkeypatch.setattr(Progress, "__call__", lambda self, info: os.kill(os.getpid(), signal.SIGTERM))
    before = signal.getsignal(signal.SIGTERM)
    assert main(["check", drive(BOUND % 0.1), "--save"]) == 2
    err = capfd.readouterr().err
    assert "stopping after the current chunk" in err
    assert "interrupted before a verdict\nhint: run the check again" in err
    assert not Path("baselines").exists()
    assert signal.getsignal(signal.SIGTERM) is before
