"""Parts that do not fit each other are refused, with the place."""

from pathlib import Path

import pytest

from avrare.cli.main import main

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.mark.parametrize(
    ("part", "block"),
    [
        ("controller", "{plugin: mpc}"),
        ("perception", "{plugin: gp_pem}"),
        ("perception", "{plugin: parametric}"),
        ("specifications.left", "{plugin: traffic_rules, rule: no_collision}"),
    ],
)
def test_what_drives_on_a_road_needs_one(part, block, capsys):
    words = ["validate", "--build", str(SCENARIOS / "double_integrator.yaml"), "--set", f"{part}={block}"]
    if part == "perception":
        words += ["--set", "tracker={plugin: imm}"]
    assert main(words) == 4
    error = capsys.readouterr().err
    assert f"{part}: " in error
    assert "driving simulator" in error
    assert "bug" not in error
