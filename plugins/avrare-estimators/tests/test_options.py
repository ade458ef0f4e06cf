"""Options of a choice by name: in a file, in Python, in a run folder, and their mistakes."""

import json

import pytest
import yaml

import avrare
from avrare.cli.main import main
from avrare.testing.problems import linear
from avrare_estimators.ess.config import EssConfig
from avrare_estimators.importance.config import IsConfig

SCENARIO = """\
name: tiny
steps: 3
simulator:
  {plugin: linear, states: [x], A: [[1]], process_noise: [1.0], initial: {mean: [0], covariance: [1.0]}}
specifications:
  near: {stl: "always (x < 3)"}
estimator:
  plugin: %s
  %s
"""


@pytest.mark.parametrize(
    ("plugin", "option", "place", "hint"),
    [
        ("ess", "kernel: {name: bayesian, pionts: 6}", "9:28: estimator.kernel.pionts: ", "mean 'points'?"),
        ("ess", "kernel: bayesan", "9:11: estimator.kernel.name: should be one of pcn, ", "mean 'bayesian'?"),
        ("ess", "kernel: {name: shrink, points: 6}", "9:26: estimator.kernel.points: ", "bracket, name"),
        ("ess", "kernel: {name: bayesian, acquisition: {name: ei, kapa: 1}}",
         "9:52: estimator.kernel.acquisition.kapa: unknown key", "known: name, xi"),
        ("ess", "kernel: lipschitz", "9:3: estimator.kernel.bound: required", "use `kernel: shrink`"),
        ("is", "proposal: {name: gaussian, maen: 1}", "9:30: estimator.proposal.maen: ", "mean 'mean'?"),
        ("is", "proposal: learnt", "9:13: estimator.proposal: should be 'learned', ", "mean 'learned'?"),
    ],
)  # fmt: skip
def test_a_mistake_has_its_place_and_a_hint(plugin, option, place, hint, tmp_path, capsys):
    path = tmp_path / "tiny.yaml"
    path.write_text(SCENARIO % (plugin, option))
    assert main(["validate", str(path)]) == 4
    mistake, advice = capsys.readouterr().err.splitlines()
    assert mistake.startswith(f"{path}:{place}")
    assert advice.startswith("hint: ")
    assert advice.endswith(hint)


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("ess", "kernel: {name: shrink, bracket: 3.0}"),
        ("ess", "kernel: bayesian"),
        ("is", "proposal: {name: gaussian, mean: 0.4}"),
    ],
)
def test_a_run_folder_holds_all_options(name, option, tmp_path):
    """Read its scenario again: the same options, the same fingerprint."""
    path = tmp_path / "tiny.yaml"
    path.write_text(SCENARIO % (name, option))
    words = ["--budget", "rollouts=60000", "--no-pictures", "--set", "estimator.runs=1"]
    assert main(["run", str(path), "--out", str(tmp_path / "first"), *words]) == 0
    stored = tmp_path / "first" / "scenario.yaml"
    assert main(["run", str(stored), "--out", str(tmp_path / "again"), *words]) == 0
    resolved, again = (yaml.safe_load((tmp_path / run / "scenario.yaml").read_text()) for run in RUNS)
    assert resolved == again
    result, repeated = (json.loads((tmp_path / run / "result.json").read_text()) for run in RUNS)
    assert result["fingerprint"] == repeated["fingerprint"]
    assert result["estimates"][0]["probability"] == repeated["estimates"][0]["probability"]


RUNS = ("first", "again")


def test_options_of_a_kernel_in_python():
    task = linear(1.0, 2).problem()
    options = {"chains": 5, "level_probability": 0.5, "runs": 2}
    whole, part = (
        avrare.estimate(task, "ess", kernel={"name": "shrink", "bracket": width}, **options)
        for width in (6.283185307179586, 3.0)
    )
    plain = avrare.estimate(task, "ess", kernel="shrink", **options)
    assert whole.run_probabilities.tolist() == plain.run_probabilities.tolist()
    assert part.run_probabilities.tolist() != plain.run_probabilities.tolist()


@pytest.mark.parametrize(
    ("options", "rollouts", "share"),
    [
        ({}, 30_000, 0.25),
        ({"relative_error": 0.1}, 300_000, 0.25),
        ({"proposal": {"name": "gaussian"}}, 30_000, 0.5),
        ({"rollouts": 500, "defensive": 0.3}, 500, 0.3),
    ],
)
def test_defaults_that_depend_on_other_options_do_not_count_as_given(options, rollouts, share):
    config = IsConfig(**options)
    assert (config.most_rollouts, config.target_share) == (rollouts, share)
    assert config.model_fields_set == set(options)
    dumped = config.model_dump()
    assert (dumped["rollouts"], dumped["defensive"]) == (rollouts, share)
    assert set(config.model_dump(exclude_unset=True)) == set(options)


def test_the_schema_has_the_names_that_may_stand_alone_and_all_branches():
    names, branches = EssConfig.model_json_schema()["properties"]["kernel"]["anyOf"]
    assert names["enum"] == ["pcn", "shrink", "lipschitz_growing", "bayesian"]
    assert set(branches["discriminator"]["mapping"]) == {*names["enum"], "lipschitz"}


def test_the_schema_tells_the_kinds_of_a_proposal_apart():
    schema = IsConfig.model_json_schema()
    learned, gaussian, plugin, python = schema["properties"]["proposal"]["oneOf"]
    assert learned["const"] == "learned"
    fields = schema["$defs"][gaussian["$ref"].rpartition("/")[2]]
    assert (set(fields["properties"]), fields["additionalProperties"]) == ({"name", "mean", "std"}, False)
    assert plugin["required"] == ["plugin"]
    assert python == {"not": {}}
