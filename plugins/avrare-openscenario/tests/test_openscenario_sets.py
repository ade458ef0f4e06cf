"""Files of parameter sets become catalogues: ``avrare new catalogue``."""

import json
from pathlib import Path

import pytest

from avrare.analysis.rates.catalogue import load_catalogue
from avrare.cli.main import main
from avrare_openscenario.distributions import list_scenes
from openscenario_files import SCENARIOS, document, event, lane_position, slow_down

STACK = """\
name: stack
steps: 2
controller: {plugin: function, file: stack.py}
specifications:
  free: {stl: "forall o in others: always (distance > 0)"}
"""
SINGLE = (
    '<DeterministicSingleParameterDistribution parameterName="{}">{}'
    "</DeterministicSingleParameterDistribution>"
)
SET = "<DistributionSet>{}</DistributionSet>"
CONSTRAINED = (
    '<ParameterDeclaration name="w" parameterType="double" value="1"><ConstraintGroup>'
    '<ValueConstraint rule="lessThan" value="${$v / 10}"/></ConstraintGroup></ParameterDeclaration>'
    "</ParameterDeclarations>"
)


def values(name, *texts):
    return SINGLE.format(name, SET.format("".join(f'<Element value="{text}"/>' for text in texts)))


def steps(name, low, high, step):
    bounds = f'<Range lowerLimit="{low}" upperLimit="{high}"/>'
    return SINGLE.format(name, f'<DistributionRange stepWidth="{step}">{bounds}</DistributionRange>')


def together(*choices):
    sets = (
        "".join(f'<ParameterAssignment parameterRef="{k}" value="{v}"/>' for k, v in choice.items())
        for choice in choices
    )
    inner = "".join(f"<ParameterValueSet>{one}</ParameterValueSet>" for one in sets)
    return (
        "<DeterministicMultiParameterDistribution><ValueSetDistribution>"
        f"{inner}</ValueSetDistribution></DeterministicMultiParameterDistribution>"
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a function that writes a template and a file of its parameter sets."""
    monkeypatch.chdir(tmp_path)
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    road = (SCENARIOS / "openscenario" / "motorway.xodr").read_text(encoding="utf-8")
    (scenes / "motorway.xodr").write_text(road, encoding="utf-8")
    Path("stack.yaml").write_text(STACK)
    Path("stack.py").write_text("def act(observation):\n    return 0.0, 0.0\n")

    def write(*axes):
        text = document(event(slow_down(target="$w")), car=lane_position(30, "$lane")).replace(
            "</ParameterDeclarations>", CONSTRAINED
        )
        (scenes / "template.xosc").write_text(text)
        (scenes / "sets.xosc").write_text(
            '<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="" description="" author=""/>'
            '<ParameterValueDistribution><ScenarioFile filepath="template.xosc"/>'
            f"<Deterministic>{''.join(axes)}</Deterministic></ParameterValueDistribution></OpenSCENARIO>"
        )
        return scenes

    return write


def list_cells():
    entries = load_catalogue("scenes.yaml").document.scenes
    found = [dict(one.removeprefix("simulator.").split("=", 1) for one in entry.set[1:]) for entry in entries]
    return found, [entry.cells for entry in entries]


def test_sets_and_ranges_multiply_and_a_cell_is_a_scene(folder, capsys):
    axes = values("lane", -2, -3), together({"v": 20, "w": 1}, {"v": "${2 * 15}", "w": 2.5})
    assert main(["new", "catalogue", str(folder(*axes)), "--stack", "stack.yaml"]) == 0
    assert "4 scenes of 4 cells" in capsys.readouterr().out
    cells, weights = list_cells()
    assert weights == [1] * 4
    assert [tuple(cell.values()) for cell in cells] == [
        ("-2", "20", "1"), ("-2", "30", "2.5"), ("-3", "20", "1"), ("-3", "30", "2.5"),
    ]  # fmt: skip


def test_the_ends_of_a_range_are_in_it(folder):
    [scene] = list_scenes(str(folder(steps("v", 10, 10.3, 0.1))), None)
    assert [choice["parameters.v"] for choice in scene.axes[0]] == ["10", "10.1", "10.2", "10.3"]
    assert scene.options["entity"] == "Ego"  # and the template is no scene of its own


def test_cells_that_a_constraint_forbids_are_left_out(folder, capsys):
    main(["new", "catalogue", str(folder(steps("v", 10, 30, 10), values("w", 1.5))), "--stack", "stack.yaml"])
    assert [cell["parameters.v"] for cell in list_cells()[0]] == ["20", "30"]
    assert "sets.xosc (1 cell): " in capsys.readouterr().err


def test_many_cells_are_a_law_of_the_numbers_that_can_be_drawn(folder):
    axes = values("lane", -2, -3), steps("v", 10, 40, 0.5), steps("w", 0.5, 3.5, 0.5)
    assert main(["new", "catalogue", str(folder(*axes)), "--stack", "stack.yaml"]) == 0
    cells, weights = list_cells()
    assert [cell["parameters.lane"] for cell in cells] == ["-2", "-3"]
    law = json.loads(cells[0]["parameters.v"])
    assert (law["law"], len(law["values"]), set(law["weights"])) == ("discrete", 61, {1.0})
    possible = sum(w < v / 20 for v in range(20, 81) for w in (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5))
    assert weights == [possible, possible]


def test_forbidden_values_are_drawn_again(folder, capsys):
    scenes = folder(steps("v", 10, 40, 0.5), steps("w", 0.5, 3.5, 0.5))
    assert main(["new", "catalogue", str(scenes), "--stack", "stack.yaml"]) == 0
    capsys.readouterr()
    assert main(["rate", "scenes.yaml", "--out", "out", "--budget", "rollouts=40", "--json"]) == 0
    rates = json.loads(capsys.readouterr().out)
    assert rates["scenes"][0]["errors"] == 0
    assert rates["scenes"][0]["unit"] == "cell"
    result = json.loads(Path("out/scenes/sets_1/result.json").read_text())
    assert "scenes redrawn" in result["estimates"][0]["notes"][0]["text"]


def test_equal_cells_are_one_scene_and_files_that_are_not_read_are_named(folder, capsys):
    scenes = folder(values("v", 20))
    (scenes / "again.xosc").write_text((scenes / "sets.xosc").read_text())
    (scenes / "broken.xosc").write_text("<OpenSCENARIO")
    assert main(["new", "catalogue", str(scenes), "--stack", "stack.yaml"]) == 0
    printed = capsys.readouterr()
    assert "1 scene of 1 cell" in printed.out
    assert "broken.xosc:1:" in printed.err


def test_a_catalogue_of_laws_and_of_plain_scenes(folder, capsys):
    text = (
        document(event(slow_down())).replace('entityRef="Ego"', 'entityRef="Hero"').replace('"Ego"', '"Hero"')
    )
    scenes = folder(values("v", 20))
    (scenes / "sets.xosc").write_text(
        (scenes / "sets.xosc").read_text().split("<Deterministic>")[0]
        + '<Stochastic numberOfTestRuns="9"><StochasticDistribution parameterName="v"><UniformDistribution>'
        '<Range lowerLimit="20" upperLimit="30"/></UniformDistribution></StochasticDistribution></Stochastic>'
        "</ParameterValueDistribution></OpenSCENARIO>"
    )
    (scenes / "plain.xosc").write_text(text)
    assert main(["new", "catalogue", str(scenes), "--stack", "stack.yaml"]) == 0
    assert "there is no entity 'Ego'" in capsys.readouterr().err
    [entry] = load_catalogue("scenes.yaml").document.scenes
    assert "scenes/sets.xosc" in entry.set[0]  # the laws stay in their file
    Path("scenes.yaml").unlink()
    assert (
        main(["new", "catalogue", str(scenes / "plain.xosc"), "--ego", "Hero", "--stack", "stack.yaml"]) == 0
    )


def test_without_a_stack_a_first_one_is_written(folder):
    assert main(["new", "catalogue", str(folder(values("v", 20)))]) == 0
    assert load_catalogue("scenes.yaml").rules == ("no_contact",)
    assert Path("scenes_stack.py").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere: no such file or folder"),
        (["scenes", "--stack", "no.yaml"], "no.yaml: no such file"),
        (["scenes", "--act"], "a catalogue takes"),
    ],
)
def test_mistakes_are_named(folder, capsys, words, message):
    folder(values("v", 20))
    assert main(["new", "catalogue", *words]) == 4
    assert message in capsys.readouterr().err


def test_a_folder_without_scenes_and_a_file_that_is_there(folder, capsys):
    scenes = folder(values("v", -1))
    assert main(["new", "catalogue", str(scenes), "--stack", "stack.yaml"]) == 4
    assert "has no scene that the stack can drive in" in capsys.readouterr().err
    folder(values("v", 20))
    Path("scenes.yaml").write_text("mine")
    assert main(["new", "catalogue", str(scenes), "--stack", "stack.yaml"]) == 4
    assert Path("scenes.yaml").read_text() == "mine"


@pytest.mark.parametrize("mine", ["v", "scenes.yaml", "scenes_stack.py"])
def test_a_refusal_leaves_only_what_was_there(folder, mine):
    folder(values("v", -1 if mine == "v" else 20))
    if mine != "v":
        Path(mine).write_text("mine")
    before = sorted(Path().glob("*"))
    assert main(["new", "catalogue", "scenes"]) == 4
    assert sorted(Path().glob("*")) == before
