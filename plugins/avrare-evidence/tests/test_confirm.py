"""Confirmation of packs with other random numbers."""

import json

import pytest
import yaml
from evidence_packs import make_pack, replace

import avrare_evidence.confirm as confirmation
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare_evidence.pack import hash_file

TRIPLED = "simulator.initial.mean=[0.513]"
"""P(x >= 2) = 0.0228 becomes 0.0684."""


def test_a_confirmation_agrees_and_leaves_a_sheet(point, capsys):
    pack = make_pack(point)
    assert main(["confirm", str(pack.folder), "--seed", "3", "--vary", TRIPLED]) == 0
    sheet = yaml.safe_load((pack.folder / "confirmation.yaml").read_text())
    assert (sheet["outcome"], sheet["signed_off"]["name"]) == ("agree", None)
    assert sheet["comparisons"][0]["power"] > 0.9
    assert [row["verdict"] for row in sheet["variations"]] == ["fail"]
    assert main(["evidence", "--check", str(pack.folder)]) == 0  # the sheet belongs to no manifest


def test_a_confirmation_that_could_not_notice_decides_nothing(point):
    pack = make_pack(point, "estimator.rollouts=50")
    assert confirmation.confirm(pack.folder, 3).outcome == "not decided"


def test_a_pack_without_failures_disagrees_where_many_drives_break(point, monkeypatch):
    load, far = confirmation.load, "simulator.initial.mean=[-9]"
    pack = make_pack(point, far)
    assert confirmation.confirm(pack.folder, 3, budget="rollouts=100000").comparisons[0]["p_value"] == 1.0
    near = far.replace("-9", "0")
    monkeypatch.setattr(confirmation, "load", lambda path, settings: load(path, [*settings, near]))
    assert confirmation.confirm(pack.folder, 3).outcome == "disagree"


def test_a_confirmation_needs_the_same_system(point, monkeypatch):
    pack = make_pack(point)
    with pytest.raises(UsageError, match="seed 0 is that of the pack"):
        confirmation.confirm(pack.folder, 0)
    monkeypatch.setattr("avrare_evidence.pack.distributions", list)
    with pytest.raises(UsageError, match=r"avrare-linear: .* in the pack, not installed here"):
        confirmation.confirm(pack.folder, 3)
    assert len(confirmation.confirm(pack.folder, 3, accept_changes=True).version_changes) == 2


def test_code_that_a_pack_names_is_refused_in_safe_mode(point, monkeypatch, capsys):
    pack = make_pack(point)
    monkeypatch.chdir(pack.folder)  # Python would import files of the folder of the tests
    assert main(["confirm", ".", "--seed", "3", "--safe"]) == 0
    scenario = pack.folder / "repeat/point.yaml"
    content = yaml.safe_load(scenario.read_text())
    content["simulator"] = {"plugin": "python", "file": "world.py", "class": "World"}
    scenario.write_text(yaml.safe_dump(content))
    entry = '"repeat/point.yaml": "{}"'.format
    old, new = pack.manifest.files["repeat/point.yaml"], hash_file(scenario)
    replace(pack.folder, entry(old), entry(new))
    assert main(["confirm", ".", "--seed", "4", "--safe"]) == 4
    assert "safe mode runs installed plugins only, and no Python files" in capsys.readouterr().err


@pytest.mark.slow
def test_false_alarms_and_power_over_a_hundred_packs(point, monkeypatch):
    load, alarms, noticed = confirmation.load, 0, 0
    for seed in range(100):
        pack = make_pack(point, f"seed={2 * seed}", name=f"pack{seed}")
        alarms += confirmation.confirm(pack.folder, 2 * seed + 1).outcome == "disagree"
        monkeypatch.setattr(confirmation, "load", lambda path, settings: load(path, [*settings, TRIPLED]))
        noticed += confirmation.confirm(pack.folder, 2 * seed + 1).outcome == "disagree"
        monkeypatch.setattr(confirmation, "load", load)
    print(json.dumps({"alarms": alarms, "noticed": noticed}))
    assert alarms <= 8
    assert noticed >= 90
