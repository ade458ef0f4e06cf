"""Packs: claims of runs, checks and rates, what speaks against them, and mistakes."""

import json
import shutil

import pytest
import yaml
from evidence_packs import list_challenges, list_claims, make_pack

import avrare
import avrare_evidence.confirm as confirmation
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare_evidence.argument import STATES
from avrare_evidence.pack import Pack, hash_files, write_pack

CATALOGUE = """\
name: points
budget: {rollouts: 4000}
pilot: 20
scenes:
  - {name: near, scenario: point.yaml, exposure: {per_hour: 2.0}, odd: [wet]}
  - {name: far, scenario: point.yaml, exposure: {count: 5, hours: 1.0}}
thresholds: [{rule: below, per_hour: "< 0.01"}]
"""


def test_a_pack_holds_claim_evidence_and_tags(point):
    pack = make_pack(point)
    [claim] = list_claims(pack)
    assert (STATES[claim.measure.verdict], claim.measure.bound, list_challenges(pack)) == (
        "holds",
        "< 0.04",
        [],
    )
    assert Pack.read(pack.folder).find_faults() == []
    solution = pack.case["Sn1"]
    assert pack.manifest.files[solution.url] == solution.sha256
    [sheet] = pack.case["C1"].sheets
    sheet = yaml.safe_load((pack.folder / sheet).read_text())
    tags = [sheet[key] for key in ("requirements", "odd", "objective")]
    assert tags == [["R-1"], ["dry"], "stay below the bound"]
    assert sheet["expected"] == ["below < 0.04"]
    assert sheet["actual"]["verdicts"] == {"below < 0.04": "pass"}


def test_the_same_results_give_the_same_bytes(point):
    first = make_pack(point)
    write_pack([point / "run-pack"], point / "again")
    assert hash_files(first.folder) == hash_files(point / "again")


@pytest.mark.parametrize(
    ("bound", "state", "defeated"),
    [("< 0.04", "holds", False), ("< 0.0228", "not shown", True), ("< 0.01", "refuted", True)],
)
def test_a_goal_is_defeated_where_a_challenge_decides(point, bound, state, defeated):
    pack = make_pack(point, f"thresholds.0.probability={bound}")
    [claim] = list_claims(pack)
    assert (STATES[claim.measure.verdict], claim.defeated) == (state, defeated)
    assert ("decides the verdict" in (pack.folder / "case.md").read_text()) is defeated


def test_what_a_search_may_have_missed_decides_a_claim_that_assumes_it_away(point):
    pack = make_pack(
        point, "estimator.rollouts=2000", "thresholds.0.probability=< 0.0005", "simulator.initial.mean=[-2]"
    )
    blind = make_pack(
        point,
        "thresholds.0.probability=< 0.0002",
        "simulator.initial.mean=[-2]",
        estimator="ess",
        name="blind",
    )
    assert not any("search" in challenge.text for challenge in list_challenges(pack))
    [claim] = list_claims(blind)
    [challenge] = [challenge for challenge in list_challenges(blind) if "search" in challenge.text]
    assert challenge.decides is (claim.measure.verdict == "pass_assuming")
    assert claim.measure.verdict == "pass_assuming"


def test_each_bound_of_a_rule_has_a_verdict_of_its_own(point):
    bounds = ", ".join(f"{{specification: below, probability: '< {bound}'}}" for bound in (0.04, 0.01))
    assert [
        STATES[claim.measure.verdict] for claim in list_claims(make_pack(point, f"thresholds=[{bounds}]"))
    ] == [
        "holds",
        "refuted",
    ]


def test_a_catalogue_is_claimed_by_its_rates(point):
    (point / "points.yaml").write_text(CATALOGUE)
    avrare.rate(point / "points.yaml", out=point / "rates")
    pack = write_pack([point / "rates"], point / "pack")
    [claim] = list_claims(pack)
    assert claim.measure.verdict == "fail"
    assert claim.measure.unit == "per hour"
    assert yaml.safe_load((pack.folder / "test-cases/points/scenes/near.yaml").read_text())["odd"] == ["wet"]
    assert Pack.read(pack.folder).find_faults() == []
    assert confirmation.confirm(pack.folder, 5).outcome == "agree"


def test_a_reference_driver_and_scattered_exposures_are_argued(point):
    counts = "{counts: [0, 9, 1, 12], hours: 1.0}"
    (point / "points.yaml").write_text(CATALOGUE.replace("{count: 5, hours: 1.0}", counts))
    avrare.rate(point / "points.yaml", out=point / "rates")
    summary = json.loads((point / "rates" / "rate.json").read_text())
    summary["reference"] = {"driver": "reference_driver=fsm"}
    (point / "rates" / "rate.json").write_text(json.dumps(summary))
    shutil.copytree(point / "rates/scenes", point / "rates/reference/scenes")
    pack = write_pack([point / "rates"], point / "pack")
    assert list_claims(pack)[-1].text == "points: the stack breaks below less often than reference_driver=fsm"
    assert (STATES[list_claims(pack)[-1].measure.verdict], list_claims(pack)[-1].defeated) == (
        "not shown",
        True,
    )
    doubts = [element.text for element in pack.case.values() if element.challenges == "A1"]
    assert "Scene near: its exposure is stated without an interval" in doubts[0]
    assert "Scene far: its counts scatter 6.4 times as much as Poisson's" in doubts[1]
    assert Pack.read(pack.folder).find_faults() == []


@pytest.mark.parametrize(("mean", "low", "verdict"), [("0", 0.5, "pass"), ("-9", 20.0, "fail")])
def test_a_check_with_a_baseline_is_claimed_by_the_change(point, mean, low, verdict):
    file, base = str(point / "point.yaml"), ["--baseline", str(point / "base")]
    before = ["--set", f"simulator.initial.mean=[{mean}]", "--save", "--out", str(point / "old")]
    assert main(["check", file, *base, *before]) == 0
    main(["check", file, *base, "--seed", "5", "--accept-changes", "--out", str(point / "new")])
    pack = write_pack([point / "new"], point / "pack")
    _, change = list_claims(pack)
    assert (change.measure.bound, change.measure.verdict, change.measure.unit) == (
        "<= baseline",
        verdict,
        "times",
    )
    assert low < change.measure.low < change.measure.high
    assert Pack.read(pack.folder).find_faults() == []
    assert confirmation.confirm(pack.folder, 7).outcome == "agree"


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda p: shutil.rmtree(p / "run-pack"), "no result in it"),
        (lambda p: (p / "run-pack/scenario.yaml").open("a").write("#"), "changed after the run"),
        (lambda p: (p / "run-pack/manifest.json").write_text("{}"), "is a pack itself"),
        (lambda p: (p / "run-pack/check.json").write_text('{"rows": [{}]}'), "check.json: it cannot be read"),
        (lambda p: (p / "other").mkdir() or (p / "other/file").touch(), "is not an empty folder"),
    ],
)
def test_mistakes_are_explained(point, spoil, text, capsys):
    make_pack(point)
    spoil(point)
    assert main(["evidence", str(point / "run-pack"), "--out", str(point / "other")]) == 4
    assert text in capsys.readouterr().err


def test_two_results_of_one_name_are_refused(point):
    make_pack(point)
    with pytest.raises(UsageError, match="two of the results are named 'point'"):
        write_pack([point / "run-pack", point / "run-pack"], point / "both")
