"""Verdicts of crmonitor on its own trajectories, where they lie beside the checkout; see the page."""

import json
from pathlib import Path

import pytest

from avrare.driving import Road
from avrare_recordings.formats.csv_recording import read_csv
from judged_recordings import judge

FOLDER = Path(__file__).parents[4] / "shared" / "conformance" / "crmonitor"
DIFFERENT = {
    "R_G1.csv": {"v1003", "v1004", "v1008"},
    "R_I1.csv": {"v1008"},
    "R_I2_broad_marking.csv": {"v1001", "v1002"},
    "R_I4.csv": {"v1008"},
}
"""Egos whose verdict differs, each explained on the page."""


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER.exists(), reason="the trajectories are not beside the checkout")
def test_agrees_but_for_the_differences_on_the_page():
    compared = 0
    for case in json.loads((FOLDER / "expected.json").read_text(encoding="utf-8")):
        ramp = (int(case["access_ramp"]),) if "access_ramp" in case else ()
        marked = (1,) if "broad" in case["file"] else ()
        road = Road(tuple(case["lane_centres"]), case["lane_width"], ramp, broad_markings=marked)
        different = set()
        for ego, kept in case["verdicts"].items():
            recording = read_csv(str(FOLDER / case["file"]), ego, road)
            compared += 1
            if judge(case["rule"], recording, case["parameters"])[0] == kept:
                different.add(ego)
        assert different == DIFFERENT.get(case["file"], set()), case["file"]
    assert compared == 87
