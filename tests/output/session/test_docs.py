"""The program of docs/python.md runs, and so does each function of its table."""

import re
from pathlib import Path

import pytest

import avrare
from avrare.driving import Road

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| `avrare \w+.*?\| `(avrare\..*?)` \| `(\w+)`", PAGE, flags=re.MULTILINE)
SETTINGS = [
    "steps=20", "specifications={near: {stl: 'always (y < 0.2)'}}", "estimator={plugin: mc, rollouts: 1000}",
]  # fmt: skip
HERE = {
    'out="runs/a"': 'out="runs/c"',
    "perception.miss_scale": "simulator.process_noise.0.3.3",
    '"controller.gain"': '"simulator.process_noise.0.3.3", steps=2, proof=500',
    '"R_I2"]': '"R_I2"], road=ROAD',
}
"""Words of the page -> those for a scenario without perception, beside a run that exists."""
CATALOGUE = """\
name: scenes
budget: {rollouts: 300}
pilot: 50
scenes:
  - {name: often, scenario: scenario.yaml, exposure: {per_hour: 2.0}}
  - {name: seldom, scenario: scenario.yaml, exposure: {count: 3, hours: 10.0}}
thresholds: [{rule: near, per_hour: "< 5"}]
"""
DRIVE = """\
time,vehicle,x,y,heading,speed,length,width
0.0,a,0,1.75,0,20,4,2
0.0,b,15,1.75,0,20,4,2
0.1,a,2,1.75,0,20,4,2
0.1,b,17,1.75,0,20,4,2
"""


def test_the_program_of_the_page_runs(tmp_path, monkeypatch, capsys):
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "python.md", "exec"), {})
    assert "no_crawling" in capsys.readouterr().out
    assert (tmp_path / "failure.png").stat().st_size > 5000
    assert "Worst" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the files that the table names."""
    folder = tmp_path_factory.mktemp("page")
    run = avrare.run(ROOT / "scenarios" / "double_integrator.yaml", SETTINGS, folder / "runs" / "a")
    text = run.scenario_text
    (folder / "scenario.yaml").write_text(text)
    (folder / "other.yaml").write_text(text)
    (folder / "catalogue.yaml").write_text(CATALOGUE)
    (folder / "drives").mkdir()
    (folder / "drives" / "one.csv").write_text(DRIVE)
    return folder


def test_the_table_has_a_row_for_every_command_that_is_a_function():
    functions = {call.partition("(")[0].removeprefix("avrare.") for call, _ in ROWS}
    commands = "validate run check rate compare compare_versions falsify replay why sensitivity require"
    assert functions == {*commands.split(), "monitor", "synthesise", "monitor_all", "report"}


@pytest.mark.parametrize(("call", "name"), ROWS)
def test_a_row_of_the_table_runs_and_returns_what_it_says(folder, monkeypatch, call, name):
    monkeypatch.chdir(folder)
    for word, here in HERE.items():
        call = call.replace(word, here)
    value = eval(call, {"avrare": avrare, "ROAD": Road((1.75, 5.25), 3.5)})
    assert type(value).__name__ == name.replace("Path", type(Path()).__name__)
    if name != "Path":
        assert "object at 0x" not in repr(value)
        assert value.table() or name == "Validation"  # of a valid file
        assert all(isinstance(row, dict) for row in value.table())
        assert value._repr_html_().startswith("<")
