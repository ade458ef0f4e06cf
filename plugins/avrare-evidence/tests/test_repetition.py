"""Repetition of a pack's results from its own files."""

import shlex
import shutil
from pathlib import Path

import pytest
from evidence_packs import list_claims, make_pack

import avrare
import avrare_evidence.confirm as confirmation
from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare_evidence.pack import write_pack

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


def repeat(pack, monkeypatch):
    """Call the command of the page in a copy of the folder ``repeat``, and return its exit code."""
    monkeypatch.chdir(shutil.copytree(pack.folder / "repeat", pack.folder.parent / "repeat"))
    [command] = (pack.folder / "case.md").read_text().split("```console\n")[1].split("```")[0].splitlines()
    return main(shlex.split(command)[1:])


def test_a_pack_is_repeated_from_its_own_folder(point, monkeypatch):
    pack = make_pack(point)
    assert repeat(pack, monkeypatch) == 0
    again, stored = (
        avrare.Run.read("runs/point")["below"],
        avrare.Run.read(pack.folder / "evidence/point")["below"],
    )
    assert (again.probability, again.interval) == (stored.probability, stored.interval)


def test_a_file_of_an_option_travels_and_a_shipped_model_must_be_the_same(point, monkeypatch, tmp_path):
    shutil.copy(__file__, tmp_path / "model.npz")
    from avrare_linear.config import LinearConfig

    monkeypatch.setattr(LinearConfig, "used_models", lambda self: {"A": tmp_path / "model.npz"})
    pack = make_pack(point)
    [copy] = pack.manifest.runs["point"].values()
    assert (pack.folder / copy).read_bytes() == (tmp_path / "model.npz").read_bytes()
    (tmp_path / "model.npz").write_text("another model")
    with pytest.raises(UsageError, match=r"simulator.A: the file model.npz is missing here, or not that of"):
        confirmation.confirm(pack.folder, 3)


def test_files_of_options_keep_their_places_and_are_read_from_the_pack(point, monkeypatch):
    from avrare_linear.config import LinearConfig

    for name in ("maps/road.xml", "catalogs/cars.xml"):
        (point / name).parent.mkdir()
        (point / name).write_text(name)
    files = {"file": point / "maps/road.xml", "file.0": point / "catalogs/cars.xml"}
    monkeypatch.setattr(LinearConfig, "used_files", lambda self: files)
    pack = make_pack(point)
    copies = pack.manifest.runs["point"]
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
    files = write_pack(["run"], "pack").manifest.runs["cut_in"]
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


def test_a_check_of_several_looks_is_repeated_with_its_baseline(point, monkeypatch):
    def check(folder, *options):
        words = ["check", str(point / "point.yaml"), "--out", str(point / folder), *options]
        words += ["--budget", "rollouts=20000", "--baseline", str(point / "base")]
        words += ["--set", "specifications.low={stl: x < 1}", "--set", "thresholds.0.probability=< 0.03"]
        monkeypatch.setattr("sys.argv", ["avrare", *words])  # as the command line records it
        return main(words)

    assert check("old", "--save") == check("new", "--seed", "5", "--looks") == 0
    pack = write_pack([point / "new"], point / "pack")
    assert {claim.supported_by[0] for claim in list_claims(pack)} == {"Sn1"}
    assert pack.case["Sn1"].url == "evidence/point/check.json"
    assert repeat(pack, monkeypatch) == 0
    again, stored = avrare.Run.read("runs/point"), avrare.Run.read(pack.folder / "evidence/point")
    assert len({result.rollouts for result in stored.values()}) == 2  # the baseline decides the looks of one
    for rule, result in stored.items():
        assert (again[rule].probability, again[rule].interval) == (result.probability, result.interval)
    shutil.rmtree(point / "base")
    with pytest.raises(UsageError, match=r"0001.json: the baseline of point is missing"):
        write_pack([point / "new"], point / "late")
