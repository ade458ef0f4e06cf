"""Wrong names of noise numbers are refused before anything runs."""

import numpy as np
import pytest

import avrare
from avrare import UsageError
from avrare.cli.main import main
from plain_systems import Still

TANK = """
name: tank
steps: 4
simulator: {plugin: tank}
specifications: {dry: {stl: "always (level < 9)"}}
estimator: {plugin: mc, rollouts: 5}
"""


class Gusts(Still):
    """A system with two noise numbers."""

    noise_size = 2


def problem(**members):
    system = Gusts()
    vars(system).update(members)
    return avrare.Problem(system, avrare.stl("always (x < 9)"), steps=2)


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"noise_names": ("gust",)}, "Gusts has 1 noise_names, but noise_size is 2"),
        ({"noise_names": ("gust", "rain", "fog")}, "Gusts has 3 noise_names, but noise_size is 2"),
        ({"noise_names": "gust"}, "Gusts has noise_names 'gust', which is not a list of names"),
        ({"noise_names": 2}, "Gusts has noise_names 2, which is not a list of names"),
        ({"perfect_noise": np.zeros(3)}, "Gusts has 3 perfect_noise, but noise_size is 2"),
        ({"perfect_noise": [[0.0, 0.0]]}, r"Gusts has an array \(1, 2\) of perfect_noise, but noise_size"),
        ({"perfect_noise": "none"}, "Gusts has perfect_noise 'none', which are not numbers"),
    ],
)
def test_a_problem_refuses_names_that_do_not_fit_its_noise(members, words):
    with pytest.raises(UsageError, match=words) as caught:
        problem(**members)
    assert "one" in caught.value.hint


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"warnings": "coarse"}, "Gusts has warnings 'coarse', which are not texts by name"),
        ({"warnings": {"coarse": 3}}, "Gusts has warnings {'coarse': 3}, which are not texts by name"),
        ({"lacks": "branches"}, "Gusts has lacks 'branches', which are not texts by name"),
        ({"lacks": ("noise",)}, r"Gusts has lacks \('noise',\), which are not texts by name"),
        ({"scene": 3}, "Gusts has scene 3, which is not a Scene"),
    ],
)
def test_a_problem_refuses_declarations_of_another_type(members, words):
    with pytest.raises(UsageError, match=words) as caught:
        problem(**members)
    assert f"or leave {next(iter(members))} out" in caught.value.hint


def test_declarations_that_fit_are_accepted():
    warnings = {"coarse": "a warning"}
    assert problem(warnings=warnings, lacks={"noise": "a clock"}).system.warnings == warnings
    assert problem(warnings={}, lacks={}, scene=None).scene is None


@pytest.mark.parametrize("command", [["validate", "--build"], ["run"]])
def test_a_scenario_says_which_part_has_them(command, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("avrare_example.tank.Tank.noise_names", ("surge", "drip"))
    path = tmp_path / "tank.yaml"
    path.write_text(TANK)
    monkeypatch.chdir(tmp_path)
    assert main([*command, "tank.yaml"]) == 4
    error = capsys.readouterr().err
    assert "tank.yaml: simulator: " in error
    assert "has 2 noise_names, but noise_size is 1" in error
    assert "hint: give one name for each noise number" in error
    assert not list(tmp_path.glob("runs/**/result.json"))
