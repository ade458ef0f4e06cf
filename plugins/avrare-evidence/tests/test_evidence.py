"""Packs of evidence: claims, challenges, digests, and confirmation with other random numbers."""

import json
import shlex
import shutil
from pathlib import Path

import pytest
import yaml

import avrare
import avrare_evidence.confirm as confirmation
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare_evidence.gsn import STATES, Element, find_faults
from avrare_evidence.pack import find_pack_faults, hash_file, hash_files, read_pack, write_pack

SCENARIO = """\
name: point
description: A point on a line
requirements: [R-1]
odd: [dry]
objective: stay below the bound
steps: 0
simulator: {plugin: linear, states: [x], A: [[1]], initial: {mean: [0], covariance: [1]}}
specifications: {below: {stl: x < 2}}
estimator: {plugin: mc, rollouts: 4000}
thresholds: [{specification: below, probability: "< 0.04"}]
"""
CATALOGUE = """\
name: points
budget: {rollouts: 4000}
pilot: 20
scenes:
  - {name: near, scenario: point.yaml, exposure: {per_hour: 2.0}, odd: [wet]}
  - {name: far, scenario: point.yaml, exposure: {count: 5, hours: 1.0}}
thresholds: [{rule: below, per_hour: "< 0.01"}]
"""
CUT_IN = """\
name: cut_in
steps: 4
simulator: {plugin: openscenario, file: scene/cut_in.xosc, entity: Ego}
perception: {plugin: gp_pem, model: measured}
tracker: {plugin: imm}
controller: {plugin: cruise}
specifications: {no_collision: {plugin: traffic_rules, rule: no_collision}}
estimator: {plugin: mc, rollouts: 10}
"""
TRIPLED = "simulator.initial.mean=[0.513]"
"""P(x >= 2) = 0.0228 becomes 0.0684."""


@pytest.fixture
def point(tmp_path):
    (tmp_path / "point.yaml").write_text(SCENARIO)
    return tmp_path


def make_pack(point, *overrides, estimator=None, name="pack"):
    avrare.run(point / "point.yaml", overrides, out=point / f"run-{name}", estimator=estimator)
    return write_pack([point / f"run-{name}"], point / name)


def list_claims(pack):
    return [element for element in pack.case.values() if element.measure]


def list_states(pack):
    return [STATES[claim.measure.verdict] for claim in list_claims(pack)]


def list_challenges(pack):
    return [element for element in pack.case.values() if element.challenges == "G2"]


def test_a_pack_holds_claim_evidence_and_tags(point):
    pack = make_pack(point)
    [claim] = list_claims(pack)
    assert (STATES[claim.measure.verdict], claim.measure.bound, list_challenges(pack)) == (
        "holds",
        "< 0.04",
        [],
    )
    assert find_pack_faults(read_pack(pack.folder)) == []
    context = pack.case["C1"].scenarios["test-cases/point.yaml"]
    assert (context["requirements"], context["odd"], context["objective"]) == (
        ["R-1"],
        ["dry"],
        "stay below the bound",
    )
    solution = pack.case["Sn1"]
    assert pack.manifest.files[solution.url] == solution.sha256
    sheet = yaml.safe_load((pack.folder / "test-cases" / "point.yaml").read_text())
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


def test_a_catalogue_is_claimed_by_its_rates(point):
    (point / "points.yaml").write_text(CATALOGUE)
    avrare.rate(point / "points.yaml", out=point / "rates")
    pack = write_pack([point / "rates"], point / "pack")
    [claim] = list_claims(pack)
    assert claim.measure.verdict == "fail"
    assert claim.measure.unit == "per hour"
    assert pack.case["C1"].scenarios["test-cases/points/scenes/near.yaml"]["odd"] == ["wet"]
    assert find_pack_faults(read_pack(pack.folder)) == []
    assert confirmation.confirm(pack.folder, 5).outcome == "agree"


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (
            lambda f: (f / "evidence/point/result.json").write_bytes(b"x"),
            "evidence/point/result.json: was changed",
        ),
        (lambda f: (f / "evidence/point/scenario.yaml").open("a").write("#"), "scenario.yaml: was changed"),
        (lambda f: (f / "evidence/point/provenance.json").unlink(), "provenance.json: is missing"),
        (lambda f: (f / "evidence/extra.txt").write_text(""), "evidence/extra.txt: is not in the manifest"),
    ],
)
def test_every_change_of_a_file_is_named(point, spoil, fault, capsys):
    pack = make_pack(point)
    spoil(pack.folder)
    assert main(["evidence", "--check", str(pack.folder)]) == 1
    assert fault in capsys.readouterr().out
    assert main(["confirm", str(pack.folder)]) == 4
    assert fault in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"X1": {"text": "?"}}, "V01"),
        ({"G2": {"text": "without support"}}, "V02"),
        ({"G1": {"text": "top", "supportedBy": ["C1"]}}, "V04"),
        ({"G1": {"text": "top", "supportedBy": ["Sn1", "Sn1"]}}, "V05"),
        ({"G1": {"text": "top", "supportedBy": ["G1"]}}, "V06"),
        ({"G1": {"text": "top", "supportedBy": ["Sn1"], "defeated": True}}, "V10"),
        ({"S1": {"text": "s", "supportedBy": ["Sn1"], "challenges": "G1"}}, "V12"),
        ({"G2": {"text": "second top", "supportedBy": ["Sn1"]}}, "C01"),
        ({"G1": {"text": "top", "supportedBy": ["Sn9"]}}, "C03"),
        ({"G1": {"text": "top", "supportedBy": ["S1"]}, "S1": {"text": "s", "supportedBy": ["G1"]}}, "C04"),
    ],
)
def test_rules_of_the_notation(change, rule):
    case = {"G1": {"text": "top", "supportedBy": ["Sn1"], "inContextOf": ["C1"]}}
    case |= {"Sn1": {"text": "result"}, "C1": {"text": "scene"}}
    assert find_faults(read(case)) == []
    assert any(fault.startswith(rule) for fault in find_faults(read(case | change)))


def read(case):
    return {key: Element.model_validate(element) for key, element in case.items()}


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


def test_a_file_of_an_option_travels_and_a_shipped_model_must_be_the_same(point, monkeypatch, tmp_path):
    shutil.copy(__file__, tmp_path / "model.npz")
    from avrare_linear.config import LinearConfig

    monkeypatch.setattr(LinearConfig, "used_models", lambda self: {"A": tmp_path / "model.npz"})
    pack = make_pack(point)
    [copy] = [name for entry in pack.manifest.runs for name in entry.files.values()]
    assert (pack.folder / copy).read_bytes() == (tmp_path / "model.npz").read_bytes()
    (tmp_path / "model.npz").write_text("another model")
    with pytest.raises(UsageError, match=r"simulator.A: the file model.npz is missing here, or not that of"):
        confirmation.confirm(pack.folder, 3)


def test_a_pack_is_repeated_from_its_own_folder(point, monkeypatch):
    pack = make_pack(point)
    monkeypatch.chdir(pack.folder / "repeat")
    [command] = [
        line for line in Path("../case.md").read_text().splitlines() if line.startswith("avrare run")
    ]
    assert main(shlex.split(command)[1:]) == 0
    again, stored = (
        avrare.Run.read("../../repeated/point")["below"],
        avrare.Run.read("../evidence/point")["below"],
    )
    assert (again.probability, again.interval) == (stored.probability, stored.interval)
    assert main(["evidence", "--check", ".."]) == 0


def test_files_of_options_keep_their_places_and_are_read_from_the_pack(point, monkeypatch):
    from avrare_linear.config import LinearConfig

    for name in ("maps/road.xml", "catalogs/cars.xml"):
        (point / name).parent.mkdir()
        (point / name).write_text(name)
    files = {"file": point / "maps/road.xml", "file.0": point / "catalogs/cars.xml"}
    monkeypatch.setattr(LinearConfig, "used_files", lambda self: files)
    pack = make_pack(point)
    copies = pack.manifest.runs[0].files
    assert [name.partition("files/")[2].split("/")[1:] for name in copies.values()] == [
        ["maps", "road.xml"],
        ["catalogs", "cars.xml"],
    ]
    assert list(copies) == ["simulator.file", "simulator.file.0"]
    (point / "catalogs/cars.xml").write_text("edited")
    with pytest.raises(UsageError, match="are missing, or have changed since the run"):
        write_pack([point / "run-pack"], point / "late")


def test_a_scene_with_a_road_and_a_learned_model_is_confirmed_in_another_folder(
    tmp_path, monkeypatch, capsys
):
    shipped = Path(__file__).parents[3] / "scenarios/openscenario"
    for folder in ("scene", "away"):
        (tmp_path / folder).mkdir()
    for name in ("cut_in.xosc", "motorway.xodr"):
        shutil.copy(shipped / name, tmp_path / "scene")
    (tmp_path / "cut_in.yaml").write_text(CUT_IN)
    monkeypatch.chdir(tmp_path)
    avrare.run("cut_in.yaml", out="run")
    files = write_pack(["run"], "pack").manifest.runs[0].files
    names = {"simulator.file": "cut_in.xosc", "simulator.road": "motorway.xodr"}
    assert {option: Path(copy).name for option, copy in files.items()} == {
        **names,
        "perception.model": "measured.npz",
    }
    shutil.rmtree("scene")
    monkeypatch.chdir("away")
    assert main(["evidence", "../run", "--out", "late"]) == 4
    assert "relative paths in its options are those of the folder" in capsys.readouterr().err
    assert main(["confirm", "../pack", "--seed", "3", "--safe"]) == 3  # ten rollouts decide nothing


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
    assert find_pack_faults(read_pack(pack.folder)) == []
    assert confirmation.confirm(pack.folder, 7).outcome == "agree"


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
    assert "safe mode: a Python file is code of no installed plugin" in capsys.readouterr().err


def test_each_bound_of_a_rule_has_a_verdict_of_its_own(point):
    bounds = ", ".join(f"{{specification: below, probability: '< {bound}'}}" for bound in (0.04, 0.01))
    assert [
        STATES[claim.measure.verdict] for claim in list_claims(make_pack(point, f"thresholds=[{bounds}]"))
    ] == [
        "holds",
        "refuted",
    ]


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
    assert find_pack_faults(read_pack(pack.folder)) == []


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (lambda f: (f / "manifest.json").unlink(), "it is not a pack, or its writing was interrupted"),
        (
            lambda f: replace(f, '"seed": 0', '"seed": "0"'),
            "manifest.json: it cannot be read: runs.0.seed: Input should be",
        ),
        (
            lambda f: replace(f, '"folder": "evidence/point/"', '"folder": "../../run-pack/"'),
            "refers to ../../run-pack/result.json, which has no digest",
        ),
        (
            lambda f: replace(f, '"files": {}', '"files": {"a": "/etc/x"}'),
            "refers to /etc/x, which has no digest",
        ),
        (
            lambda f: (f / "case.md").unlink() or (f / "case.md").symlink_to("/etc/hosts"),
            "case.md: is a link",
        ),
        (lambda f: (f / "case.gsn.yaml").write_text("a: ["), "case.gsn.yaml: cannot be read"),
    ],
)
def test_a_pack_that_leads_elsewhere_or_is_damaged_is_refused(point, spoil, fault, capsys):
    pack = make_pack(point)
    spoil(pack.folder)
    assert main(["confirm", str(pack.folder), "--seed", "3"]) == 4
    assert fault in capsys.readouterr().err


def replace(folder, old, new):
    text = (folder / "manifest.json").read_text()
    assert old in text
    (folder / "manifest.json").write_text(text.replace(old, new, 1))


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
