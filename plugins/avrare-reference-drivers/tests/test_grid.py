"""Crash counts and single cases of JRC's published simulator (ec-jrc/JRC-FSM 01b05c2)."""

import json
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_reference_drivers.grid import cut_in

LATERAL = np.arange(18) * 0.1
GRIDS = {
    "low": (np.arange(1.0, 60.0), [(a, b) for a in range(20, 61, 10) for b in range(10, a, 10)]),
    "high": (np.arange(1.0, 120.0, 2.0), [(a, b) for a in range(70, 131, 20) for b in range(10, a, 30)]),
}
COUNTS = {
    ("low", "fsm"): [17, 52, 17, 82, 52, 17, 109, 82, 52, 17, 144, 109, 82, 52, 17],
    ("low", "cc"): [136, 231, 136, 310, 231, 136, 378, 310, 231, 136, 438, 378, 310, 231, 136],
    ("low", "rss"): [9, 56, 7, 88, 55, 7, 110, 87, 54, 7, 144, 108, 87, 54, 7],
    ("low", "reg157"): [74, 133, 74, 188, 133, 74, 241, 188, 133, 74, 304, 241, 188, 133, 74],
    ("high", "fsm"): [97, 40, 170, 71, 25, 276, 132, 54, 12, 412, 223, 97, 40],
    ("high", "cc"): [310, 167, 366, 261, 126, 406, 345, 212, 73, 419, 390, 310, 167],
    ("high", "rss"): [94, 44, 155, 72, 29, 238, 117, 54, 7, 349, 195, 93, 44],
    ("high", "reg157"): [206, 95, 322, 159, 68, 441, 265, 125, 41, 464, 382, 206, 95],
}
"""Crashes of each pair of speeds, in the order of GRIDS."""
CASES = Path(__file__).resolve().parents[4] / "shared" / "conformance" / "reference_drivers.json"


def crashes(model, grid, **options):
    gaps, pairs = GRIDS[grid]
    ego, other = (np.array(speeds)[:, None, None] / 3.6 for speeds in zip(*pairs, strict=True))
    return cut_in(model, ego, other, gaps[:, None], LATERAL, **options)[0].sum(axis=(1, 2))


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("model", ["cc", "reg157", "rss", "fsm"])
def test_every_count_of_the_published_grids(model, grid):
    assert crashes(model, grid).tolist() == COUNTS[grid, model]


def test_the_careful_driver_who_knows_the_lanes():
    assert [crashes("cc_lane", grid).sum() for grid in GRIDS] == [2780, 4966]


def test_a_driver_who_waits_for_two_seconds_collides_above_52_km_h():
    gaps = np.arange(40.0, 200.0, 5.0)
    slow = cut_in("cc", 130 / 3.6, 80 / 3.6, gaps, 1.7, ttc_reading="waits")[0]
    fast = cut_in("cc", 130 / 3.6, 70 / 3.6, gaps, 1.7, ttc_reading="waits")[0]
    settled = cut_in("cc", 130 / 3.6, 70 / 3.6, gaps, 1.7)[0]
    assert not slow.any()
    assert fast.all()
    assert not settled[gaps > 60.0].any()


def published_cases():
    if CASES.exists():
        yield from json.loads(CASES.read_text())["cases"]
    keys = ("model", "ego_kmh", "other_kmh", "gap_m", "lateral_mps", "crash", "impact_mps")
    for case in (
        ("cc", 60, 40, 10, 1.0, True, 19.57 / 3.6),
        ("reg157", 60, 40, 10, 1.0, True, 9.20 / 3.6),
        ("cc", 130, 70, 40, 1.0, True, 58.25 / 3.6),
        ("reg157", 130, 70, 40, 1.0, True, 34.08 / 3.6),
        ("cc", 130, 70, 60, 1.0, True, 4.83 / 3.6),
        ("rss", 130, 70, 40, 1.0, False, None),
        ("fsm", 130, 70, 40, 1.0, False, None),
        ("cc", 90, 70, 45, 0.2, True, 5.5156),
        ("fsm", 40, 20, 5, 0.8, True, -0.5094),
        ("rss", 40, 30, 1, 0.9, True, -4.4345),
    ):
        yield dict(zip(keys, case, strict=True))


@pytest.mark.parametrize("model", ["cc", "reg157", "rss", "fsm"])
def test_crash_and_impact_speed_of_single_cases(model):
    cases = [case for case in published_cases() if case["model"] == model]
    ego, other, gap, lateral = (
        np.array([case[key] for case in cases], dtype=float)
        for key in ("ego_kmh", "other_kmh", "gap_m", "lateral_mps")
    )
    crash, impact = cut_in(model, ego / 3.6, other / 3.6, gap, lateral)
    assert crash.tolist() == [case["crash"] for case in cases]
    known = np.array([case["impact_mps"] for case in cases], dtype=float)
    np.testing.assert_allclose(impact, known, rtol=0.0, atol=1.5e-3)


def test_single_cases_do_not_depend_on_the_batch():
    ego, gaps = np.array([20.0, 30.0, 36.0]), np.array([5.0, 20.0, 40.0])
    together = cut_in("fsm", ego, 10.0, gaps, 1.2)
    alone = [cut_in("fsm", speed, 10.0, gap, 1.2) for speed, gap in zip(ego, gaps, strict=True)]
    np.testing.assert_array_equal(together[1], np.array([float(impact) for _, impact in alone]))


def test_cut_ins_are_broadcast_and_those_that_never_meet_end_without_a_crash():
    crash, impact = cut_in("fsm", np.array([[10.0], [20.0]]), 10.0, [0.0, 5.0, 60.0], 1.0)
    assert crash.shape == impact.shape == (2, 3)
    assert not crash[0].any()  # equal speeds
    away = cut_in("cc", [10.0, 20.0, 0.0], [20.0, 10.0, 10.0], [5.0, 0.0, 30.0], [1.0, 0.5, 0.0])
    assert not away[0].any()  # the other faster; passed before it comes over; at rest
    assert np.isnan(away[1]).all()


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((20.0, 10.0, [30.0, np.nan], 1.0), "gap: nan"),
        ((np.inf, 10.0, 30.0, 1.0), "ego_speed: inf"),
        ((20.0, -5.0, 30.0, 1.0), "other_speed: -5"),
        ((20.0, 10.0, 30.0, [1.0, 1e9]), "lateral_speed: 1e.09"),
    ],
)
def test_numbers_that_are_those_of_no_cut_in_are_refused(numbers, words):
    with pytest.raises(UsageError, match=words):
        cut_in("fsm", *numbers)
    with pytest.raises(UsageError, match="choose settled or waits"):
        cut_in("cc", 20.0, 10.0, 30.0, 1.0, ttc_reading="late")
