"""Severity of failing drives against closed forms: impact, braking that avoids it, lanes, the ego's part."""

from dataclasses import replace

import numpy as np
import pytest

from avrare import stl
from avrare.analysis.failures.severity import describe_severities, measure_severity
from avrare.analysis.monitor.monitoring import monitor_recording
from avrare.driving import Road, Scene, Vehicles
from avrare.driving.geometry import ego_rectangle, other_rectangles, signed_distance
from avrare.logic.formula import FormulaMonitor
from avrare.results.recordings import Recording

DT, LENGTH, WIDTH = 0.1, 4.0, 2.0
SIZE = np.ones(1)
SCENE = Scene(DT, Road((0.0, 3.5), 3.5), LENGTH, WIDTH, ("other",), LENGTH * SIZE, WIDTH * SIZE, SIZE > 0)


def motion(x, y=0.0, speed=0.0, heading=0.0, acceleration=0.0):
    parts = np.broadcast_arrays(*(np.asarray(value, float) for value in (x, y, heading, speed, acceleration)))
    return Vehicles(*(np.array(part) for part in parts))


def severity(ego, other, formula="always (gap > 0)", scene=SCENE):
    """Return the severity of a drive that ends at its first contact, if there is one."""
    others = Vehicles(*(values[:, None] for values in vars(other).values()))
    gap = signed_distance(ego_rectangle(ego, scene), other_rectangles(others, scene))[:, 0]
    end = int(np.argmax(gap <= 0.0)) + 1 if (gap <= 0.0).any() else len(gap)
    signals = {f"ego_{name}": values[:end] for name, values in vars(ego).items()}
    signals |= {f"others_{name}": values[:end] for name, values in vars(others).items()}
    signals |= {"gap": gap[:end], "side": ego.y[:end]}
    recording = Recording("a drive", DT, 0.0, signals, scene, scene.names)
    return measure_severity(monitor_recording("rule", FormulaMonitor(stl(formula, dt=DT)), recording))


STEPS = np.arange(60)


def test_a_drive_into_a_parked_car_has_the_values_of_mechanics():
    speed, gap = 20.0, 60.0
    found = severity(motion(speed * DT * STEPS, 0.5, speed), motion(np.full(60, gap + LENGTH)))
    impact = found.impact
    assert (found.vehicle, impact.role) == ("other", "drives into it")
    assert impact.time == pytest.approx(gap / speed, abs=0.002)
    assert impact.speed == pytest.approx(speed)
    assert impact.overlap == pytest.approx(WIDTH - 0.5)
    assert impact.delta_v == pytest.approx(0.5 * speed)  # of equal masses
    assert impact.least_deceleration == pytest.approx(np.ceil(10 * speed**2 / (2 * gap)) / 10)
    last = (gap - speed**2 / 12.0) / speed
    assert impact.last_time == pytest.approx(np.floor(last / DT) * DT)
    assert found.drac == pytest.approx(speed**2 / (2 * speed), rel=0.11)  # a second before
    assert found.braking == 0.0
    text = found.describe()
    assert "ego drives into it (other) at t = 3.0 s: 20.0 m/s, overlap 1.5 m" in text
    assert "until t = 1.3 s, 3.4 m/s2 from the start on" in text


def test_a_heavier_car_changes_the_ego_more():
    wide = replace(SCENE, lengths=3.0 * LENGTH * SIZE)
    found = severity(motion(2.0 * STEPS, speed=20.0), motion(np.full(60, 68.0)), scene=wide)
    assert found.impact.delta_v == pytest.approx(0.75 * 20.0)


def test_a_lead_that_brakes_is_avoided_by_less():
    time = np.minimum(DT * STEPS, 5.0)
    lead = motion(30.0 + 20.0 * time - 2.0 * time**2, speed=20.0 - 4.0 * time, acceleration=-4.0)
    found = severity(motion(2.0 * STEPS, speed=20.0), lead)
    # both stop: 26 m between them and its 50 m of braking
    assert found.impact.least_deceleration == pytest.approx(np.ceil(10 * 400.0 / (2 * 76.0)) / 10)
    assert found.impact.role == "drives into it"


def test_an_ego_that_stands_is_hit():
    coming = motion(-30.0 + 2.0 * STEPS, speed=20.0)
    found = severity(motion(np.zeros(60)), coming)
    assert found.impact.role == "stands"
    assert (found.impact.last_time, found.impact.least_deceleration) == (None, np.inf)
    assert "never" in found.describe()


def test_an_ego_that_drives_is_hit_from_behind():
    found = severity(motion(1.0 * STEPS, speed=10.0), motion(-30.0 + 2.0 * STEPS, speed=20.0))
    assert found.impact.role == "is hit from behind"
    assert found.impact.speed == pytest.approx(10.0)
    assert found.drac == 0.0  # it is not ahead


@pytest.mark.parametrize(("mover", "role"), [("ego", "cuts in"), ("other", "drives into it")])
def test_who_comes_into_the_lane_of_whom(mover, role):
    across = motion(2.0 * STEPS, np.maximum(3.5 - 0.1 * STEPS, 0.0), 20.0, -0.05)
    straight = motion(2.0 * STEPS - 1.0, np.zeros(60), 20.0)
    found = severity(across, straight) if mover == "ego" else severity(straight, across)
    assert found.impact.role == role
    assert found.impact.overlap < 0.3


def test_reach_and_duration_of_a_violation_without_impact():
    y = np.where((STEPS >= 20) & (STEPS < 25), 0.95, 0.5)
    ego, lead = (
        motion(2.0 * STEPS, y, 20.0, acceleration=np.where(STEPS == 30, -3.0, 0.0)),
        motion(40.0 + 1.5 * STEPS, 3.5, 15.0),
    )
    found = severity(ego, lead, "always (side < 0.9)")
    assert found.impact is None
    assert found.reach == pytest.approx(0.95 + 0.5 * WIDTH - 1.75)
    assert found.duration == pytest.approx(0.5)
    assert found.braking == 3.0
    assert "0.2 m in a lane of other" in found.describe()
    text = describe_severities([found])
    assert text.startswith("ego reaches into the lane, 100 % by less than 0.3 m, median 0.2 m; ")


def test_a_rule_that_is_kept_has_no_severity():
    assert severity(motion(0.0 * STEPS), motion(0.0 * STEPS + 50.0)) is None
    assert describe_severities([]) == ""


def test_several_impacts_are_summed_up():
    near = severity(motion(2.0 * STEPS, speed=20.0), motion(np.full(60, 64.0)))
    close = severity(motion(2.0 * STEPS, speed=20.0), motion(np.full(60, 20.0)))
    hit = severity(motion(np.zeros(60)), motion(-30.0 + 2.0 * STEPS, speed=20.0))
    text = describe_severities([near, close, hit])
    assert text.startswith("67 % ego drives into it, 33 % ego stands: 20.0 m/s, overlap 2.0 m")
    assert text.endswith("6 m/s2 in time would have avoided 33 % of them")
