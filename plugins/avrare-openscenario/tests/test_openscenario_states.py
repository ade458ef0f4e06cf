"""States of acted scenes beside those of the reference player, where its scenes are here."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_openscenario.scenes_command import read_acted
from avrare_openscenario.trace import act_out

SHARED = next(
    (path / "shared" for path in Path(__file__).parents if (path / "shared/conformance").is_dir()), None
)
METRES, RADIANS, SPEED = 0.3, 0.02, 0.3
CONTROLLER = "a controller of the player's own drives it"
EDITION = "recorded with another edition of the file, whose arms are 150 m long"
ORIENTATION = "the player leaves the orientation of a route position out"
REFUSED = "swarms and other simulators are refused"
TRAILER = "trailers are left out: nobody pulls one"
FLAT = "conditions ask for distances on a flat road, also where it is banked"
SPLINE = "points of a spline are not those of the player, and who steers beside another one turns with it"
HEADING = "the heading of a lane change is that at the end of a step, the player's that at its begin"
ONCOMING = "the player leaves the route on the oncoming side of a junction"
TIMES = "times of control points are left out"
EXPLAINED = {
    ("test_ghost_restart", ""): CONTROLLER,
    ("test_ghost_restart2", ""): CONTROLLER,
    ("test_multi_controller", ""): CONTROLLER,
    ("test_ALKS", "Ego"): CONTROLLER,
    ("test_AEB_C2C_2023_NCAP_AEB_C2C_CCFtap", ""): EDITION,
    ("test_AEB_VRU_2023_NCAP_AEB_VRU_CBFA", ""): ORIENTATION,
    ("test_AEB_VRU_2023_NCAP_AEB_VRU_CPTA", ""): EDITION,
    ("test_velodrome", "Car2"): FLAT,
    ("test_lateral_distance_entity", "Target"): SPLINE,
    ("test_heading_trig", ""): HEADING,
    ("test_route_lane_change", ""): ONCOMING,
    ("test_trajectory", ""): TIMES,
    ("test_trailer_connect", "Trailer"): TRAILER,
}
"""Beginning of the test's name and entity (any where empty) -> why its states may differ, agree or not."""
TENTHS = (
    "test_repeats_and_relative_speed",
    "test_rising_edge",
    "test_traj_heading",
    "test_traj_speed",
    "test_traj_special_cases",
    "test_lane_change_simple",
    "test_lat_dist_road_coordinates",
    "test_lateral_distance_entity",
    "test_velodrome",
)
"""Tests that the player runs with steps of 0.1 s."""
MOVED = {"test_AEB_VRU_2023_NCAP_AEB_VRU_CBFA": 100.0, "test_AEB_VRU_2023_NCAP_AEB_VRU_CBNA": 100.0}
"""How much further east the crossing is than in the edition that was recorded: arms of 250, not 150 m [m]."""
LEAST = 1_070
"""States of 1,150 in acted scenes that agree at least."""
LEAST_SHARE = 0.96
"""The same as a share of those that no controller of the player's drives."""


def explain(test, entity):
    return next(
        (why for (name, who), why in EXPLAINED.items() if test.startswith(name) and who in ("", entity)), None
    )


def differ(state, row):
    x, y, heading, speed = state
    turned = 0.0 if row["heading"] is None else math.remainder(heading - row["heading"], 2.0 * math.pi)
    faster = 0.0 if row["speed"] is None else speed - row["speed"]
    apart = math.hypot(x - row["x"], y - row["y"])
    return apart > METRES or abs(turned) > RADIANS or abs(faster) > SPEED


@pytest.mark.slow
@pytest.mark.skipif(SHARED is None, reason="the recorded states are not here")
def test_states_are_those_of_the_player():
    counts, reasons = np.zeros(2, int), {}
    for case in json.loads((SHARED / "conformance/openscenario_positions.json").read_text()):
        step, rows = 0.1 if case["test"] in TENTHS else case["timestep"] or 0.01, case["rows"]
        try:
            file = read_acted(str(SHARED / "data/openscenario" / case["file"]), step)
            times, states = act_out(file, step, max(row["time"] for row in rows) + step)
        except UsageError:
            reasons.setdefault(REFUSED, []).extend([False] * len(rows))
            continue
        names = [body.name for body in file.bodies]
        for row in rows:
            at = np.abs(times - row["time"]).argmin()
            moved = next((moved for name, moved in MOVED.items() if case["test"].startswith(name)), 0.0)
            row |= {"x": row["x"] + moved}
            agrees = row["entity"] in names and not differ(states[at, names.index(row["entity"])], row)
            why = explain(case["test"], row["entity"]) or f"no reason known: {case['test']}"
            counts += agrees, 1
            reasons.setdefault(why, []).append(agrees)
    print(f"\n{counts[0]} of {counts[1]} states of acted scenes agree")
    for why, agreeing in sorted(reasons.items()):
        print(f"{sum(agreeing):>5} of {len(agreeing)} {why}")
    unexplained = {why: agreeing for why, agreeing in reasons.items() if why.startswith("no reason")}
    assert all(map(all, unexplained.values())), unexplained
    compared = [each for why in reasons.keys() - {CONTROLLER, REFUSED} for each in reasons[why]]
    print(f"{sum(compared)} of {len(compared)} that no controller drives")
    assert counts[0] >= LEAST
    assert np.mean(compared) >= LEAST_SHARE
