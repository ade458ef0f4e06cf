"""Errors about options of scenarios."""

import pytest

from avrare_single_track.config import SingleTrackConfig

EGO = {"x": 0.0, "y": 1.75, "speed": 20.0}


def config(ego=EGO, road=None, vehicles=()):
    return SingleTrackConfig.model_validate({"ego": ego, "road": road or {}, "vehicles": list(vehicles)})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"ego": {**EGO, "speed": 50.0}}, "speed must not be above speed_max"),
        ({"ego": {**EGO, "speed": -1.0}}, "greater than or equal to 0"),
        ({"ego": {**EGO, "x": float("nan")}}, "finite"),
        ({"ego": {**EGO, "speed_max": float("inf")}}, "finite"),
        ({"ego": {**EGO, "colour": "red"}}, "Extra inputs"),
        ({"road": {"lane_centres": [1.75, -1.75]}}, "must ascend"),
        ({"road": {"lane_centres": [0.0, 3.0]}}, "lanes overlap"),
        ({"road": {"lane_centres": []}}, "at least 1"),
        ({"road": {"access_ramp": [3]}}, "access_ramp must name lanes 0..2"),
        ({"vehicles": [{"name": "a", "x": 0, "y": 0}] * 2}, "a name of its own"),
        ({"vehicles": [{"name": "ego", "x": 0, "y": 0}]}, "'ego' is a reserved name in formulas"),
        ({"vehicles": [{"name": "others", "x": 0, "y": 0}]}, "'others' is a reserved name in formulas"),
        (
            {"vehicles": [{"name": "a", "x": 0, "y": 0, "speed": 9.0, "drive": {"lanes": [1, 3]}}]},
            "'a' drives on lane 3, the lanes are 0..2",
        ),
        ({"ego": {**EGO, "width": 0.0}}, "greater than 0"),
    ],
)
def test_wrong_options_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        config(**wrong)
