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
STEP = "the player's tests run it with steps of 0.1 s, in which a new speed counts for the whole step"
EDITION = "recorded with another edition of the road, whose arms are 150 m long"
FOLLOW = "the player's own limits of the vehicle shape the profile"
HEADING = "a place is reached with a heading, which is not compared"
SLOPE = "the road climbs; headings are those in the plane"
REFUSED = "swarms, other simulators and coupled trailers are refused"
EXPLAINED = {
    ("test_ghost_restart", ""): CONTROLLER,
    ("test_ghost_restart2", ""): CONTROLLER,
    ("test_multi_controller", ""): CONTROLLER,
    ("test_ALKS", "Ego"): CONTROLLER,
    ("test_ALKS", "LeadVehicle"): STEP,
    ("test_velodrome", ""): STEP,
    ("test_traj_speed", ""): STEP,
    ("test_rising_edge", ""): STEP,
    ("test_reverse_lane_change", ""): STEP,
    ("test_AEB", ""): EDITION,
    ("test_speed_profile", "Car1"): FOLLOW,
    ("test_heading_trig", ""): HEADING,
    ("test_star", ""): SLOPE,
}
"""Beginning of the test's name and entity (any where empty) -> why its states may differ, agree or not."""
LEAST = 889
"""States of 1,138 in acted scenes that agree at least; nine of ten is the goal."""


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
        step, rows = case["timestep"] or 0.01, case["rows"]
        try:
            file = read_acted(str(SHARED / "data/openscenario" / case["file"]), step)
            times, states = act_out(file, step, max(row["time"] for row in rows) + step)
        except UsageError:
            reasons.setdefault(REFUSED, []).extend([False] * len(rows))
            continue
        names = [body.name for body in file.bodies]
        for row in rows:
            at = np.abs(times - row["time"]).argmin()
            agrees = row["entity"] in names and not differ(states[at, names.index(row["entity"])], row)
            why = explain(case["test"], row["entity"]) or f"no reason known: {case['test']}"
            counts += agrees, 1
            reasons.setdefault(why, []).append(agrees)
    print(f"\n{counts[0]} of {counts[1]} states of acted scenes agree")
    for why, agreeing in sorted(reasons.items()):
        print(f"{sum(agreeing):>5} of {len(agreeing)} {why}")
    assert counts[0] >= LEAST
