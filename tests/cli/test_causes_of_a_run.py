"""Commands on the causes of failure of a finished run."""

import json
import shutil

import pytest

import avrare
from avrare.analysis.page.causes import build_causes
from avrare.cli.main import main
from avrare.results.run import Run
from avrare.results.stored_causes import read_causes
from pushed_point import pushed_point

PLANE = pushed_point(0.5, steps=10, variance=0.04)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("causes")
    (folder / "plane.yaml").write_text(PLANE)
    assert main(["run", str(folder / "plane.yaml"), "--out", str(folder / "run"), "--quiet"]) == 0
    return folder / "run"


def sensitivity(run, *words):
    scenario = str(run.parent / "plane.yaml")
    parameter = ["--parameter", "simulator.initial.mean.0", "--budget", "rollouts=200"]
    return main(["sensitivity", scenario, "--run", str(run), *parameter, *words])


def test_a_run_of_another_scenario_is_refused(run, capsys):
    assert sensitivity(run, "--set", "simulator.process_noise=[0.0, 0.09]") == 4
    assert "its failures are of another scenario: simulator differs" in capsys.readouterr().err


@pytest.mark.parametrize(
    "setting",
    [
        "estimator.rollouts=900",
        "seed=7",
        "confidence=0.9",
        "thresholds=[{specification: left, probability: '< 0.5'}]",
        "estimator={plugin: ams}",
    ],
)
def test_what_does_not_decide_a_rollout_may_differ(run, setting):
    assert sensitivity(run, "--set", setting) == 0


def test_a_scenario_that_was_changed_after_its_run_is_refused(run, tmp_path, capsys):
    copy = shutil.copytree(run, tmp_path / "run")
    (copy / "scenario.yaml").unlink()
    scenario, parameter = str(run.parent / "plane.yaml"), "simulator.initial.mean.0"
    words = ["sensitivity", scenario, "--run", str(copy), "--parameter", parameter]
    assert main(words) == 0  # the fingerprint in its result is the scenario's
    assert main([*words, "--set", "confidence=0.9"]) == 4
    assert "scenario.yaml: it was changed after the run, or is missing" in capsys.readouterr().err


def test_nothing_is_known_of_savings_without_fresh_tapes(run, tmp_path):
    assert main(["why", str(run), "--out", str(run), "--fresh", "0"]) == 0
    written = json.loads((run / "why.json").read_text())["attribution"]["left"]["perfect"]
    assert all(row["low"] is None for row in written)
    stored = Run.read(run)
    savings = build_causes(
        stored, stored["left"], read_causes(run, {"left": stored["left"].probability})
    ).savings
    assert len(savings) == len(written)
    assert all(text.endswith("; new ones were not looked for") for _, text in savings)


def test_a_variant_that_always_breaks_down_is_a_clear_error(run, capsys):
    # Numbers beyond the largest float: every rollout is an error.
    variant = "huge:simulator.A=[[1e300, 1e300], [1e300, 1e300]]"
    assert main(["why", str(run), "--fresh", "5", "--variant", variant]) == 4
    assert "rollouts with huge broke down" in capsys.readouterr().err


def test_command_and_function_draw_the_same_fresh_noise(run, tmp_path):
    scenario, folder = str(run.parent / "plane.yaml"), tmp_path / "seeded"
    assert main(["run", scenario, "--seed", "5", "--out", str(folder), "--quiet"]) == 0
    assert main(["why", str(folder), "--fresh", "100", "--out", str(folder)]) == 0
    written = json.loads((folder / "why.json").read_text())["attribution"]["left"]["noise"]
    seeded, unseeded = (avrare.why(folder, fresh=100, seed=seed).attribution.table() for seed in (None, 0))
    assert written == json.loads(json.dumps(seeded))
    assert seeded != unseeded
