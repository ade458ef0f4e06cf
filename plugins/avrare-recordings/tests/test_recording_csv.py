"""CSV files: what they become, and one clear message for whatever is wrong."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.results.recordings import ABSENT
from avrare_recordings.formats.csv_recording import read_csv

ROAD = Road((-1.75, 1.75), 3.5)
SIGNALS = "time,gap,speed\n0,5,20\n0.1,4,21\n0.2,inf,22\n"
VEHICLES = """\
time,vehicle,x,y,heading,speed,length,width
0.0,ego,0.0,1.75,0.0,20.0,4.0,2.0
0.0,a,10.0,1.75,0.0,10.0,5.0,2.5
0.1,ego,2.0,1.75,0.0,21.0,4.0,2.0
0.1,a,11.0,1.75,0.0,11.0,5.0,2.5
0.2,ego,4.1,1.75,0.0,23.0,4.0,2.0
0.2,parked,30.0,-1.75,0.0,0.0,4.0,2.0
"""


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def read(text, ego="ego", road=ROAD):
        (tmp_path / "t.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_csv("t.csv", ego, road)

    return read


@pytest.fixture
def fails(read):
    def fails(text, ego="ego"):
        with pytest.raises(UsageError) as caught:
            read(text, ego)
        return caught.value.message, caught.value.hint or ""

    return fails


def test_signals_become_columns(read):
    found = read(SIGNALS)
    assert (found.dt, found.start, found.samples, found.scene) == (0.1, 0.0, 3, None)
    assert sorted(found.signals) == ["gap", "speed"]
    np.testing.assert_array_equal(found.signals["gap"], [5.0, 4.0, np.inf])
    np.testing.assert_allclose(found.times, [0.0, 0.1, 0.2])


def test_time_may_start_anywhere_and_contain_rounding_errors(read):
    rows = "".join(f"{1700000000 + k / 30:.3f},{k}\n" for k in range(60))
    found = read("t,x\n" + rows)
    assert found.dt == pytest.approx(1 / 30, rel=1e-3)
    assert found.start == 1700000000.0


def test_vehicles_become_a_simulators_signals(read):
    found = read(VEHICLES)
    assert found.scene.names == ("a", "parked")
    np.testing.assert_array_equal(found.scene.lengths, [5.0, 4.0])
    np.testing.assert_array_equal(found.scene.moving, [True, False])
    assert (found.scene.ego_length, found.scene.ego_width, found.scene.dt) == (4.0, 2.0, 0.1)
    np.testing.assert_allclose(found.signals["ego_acceleration"], [0.0, 10.0, 20.0])
    np.testing.assert_allclose(found.signals["others_acceleration"][:, 0], [0.0, 10.0, 0.0])
    assert found.signals["distance"][0, 0] == pytest.approx(10.0 - 2.0 - 2.5)
    assert found.signals["gap"][0] == pytest.approx(5.5)
    np.testing.assert_array_equal(found.signals["gap"], found.signals["distance"].min(axis=1))


def test_an_absent_vehicle_is_far_away_and_a_number(read):
    signals = read(VEHICLES).signals
    for field, value in ABSENT.items():
        assert signals[f"others_{field}"][2, 0] == value
        np.testing.assert_array_equal(signals[f"others_{field}"][:2, 1], [value, value])
    assert signals["distance"][2, 0] > 1e6
    assert all(np.isfinite(values).all() for values in signals.values())


def test_a_recorded_acceleration_is_kept_and_a_blank_one_filled(read):
    lines = VEHICLES.splitlines()
    given = ["acceleration", "7.0", "", "", "1.5", "-3.0", ""]
    text = "\n".join(f"{line},{word}" for line, word in zip(lines, given, strict=True))
    signals = read(text).signals
    np.testing.assert_allclose(signals["ego_acceleration"], [7.0, 10.0, -3.0])
    np.testing.assert_allclose(signals["others_acceleration"][:2, 0], [0.0, 1.5])


def test_acceleration_starts_again_after_a_gap(read):
    rows = [(0, "ego", 1), (0, "a", 5), (1, "ego", 1), (2, "ego", 1), (2, "a", 9), (3, "ego", 1), (3, "a", 8)]
    text = "time,vehicle,x,y,heading,speed,length,width\n"
    text += "".join(f"{t},{name},0,0,0,{speed},4,2\n" for t, name, speed in rows)
    np.testing.assert_array_equal(read(text).signals["others_acceleration"][:, 0], [0.0, 0.0, 0.0, -1.0])


def test_the_ego_sets_the_time(read):
    text = VEHICLES + "5.0,late,0,0,0,0,4,2\n-1.0,early,0,0,0,0,4,2\n"
    assert read(text).scene.names == ("a", "parked")
    found = read(VEHICLES.replace(",ego", ",b"), ego="a")
    assert found.samples == 2
    assert found.scene.names == ("b",)


def test_another_name_of_the_column_is_recognised(read):
    for name in ("id", "Track_ID"):
        with pytest.raises(UsageError, match="column 'vehicle' is missing") as caught:
            read(VEHICLES.replace("vehicle", name, 1))
        assert caught.value.hint == f"rename the column {name} to vehicle"
    assert set(read("time,id,x,y\n0,1,2,3\n1,1,2,3\n").signals) == {"id", "x", "y"}


def test_without_a_road_there_are_signals_but_no_scene(read):
    found = read(VEHICLES, road=None)
    assert found.scene is None
    assert found.signals["gap"][0] == pytest.approx(5.5)


BROKEN = [
    ("", "t.csv:1: the file is empty"),
    ("\n\n", "t.csv:1: the file is empty"),
    ("time,x\n", "t.csv: there are no rows below the header"),
    ("x,y\n1,2\n", "t.csv:1: there is no column 'time' or 't'"),
    ("time\n0\n1\n", "t.csv:1: there is no signal column besides the time"),
    ("time;x\n0;1\n", "t.csv:1: the columns are separated by semicolons"),
    ("time\tx\n0\t1\n", "t.csv:1: the columns are separated by tabs"),
    ("time,x,x\n0,1,1\n", "t.csv:1: two columns are called 'x'"),
    ("time,x,\n0,1,1\n", "t.csv:1: column 3 has no name"),
    ("time,x\n0,1\n1,2,3\n", "t.csv:3: 3 values, but the header has 2 columns"),
    ("time,x\n0,1\n1,two\n", "t.csv:3: x: should be a number, found 'two'"),
    ("time,x\n0,1\n1,1_0\n", "t.csv:3: x: should be a number, found '1_0'"),
    ("time,x\n0,1\n\n1,\n", "t.csv:4: x: should be a number, the cell is empty"),
    ("time,x\n0,1\n1,nan\n", "t.csv:3: x: NaN is not a valid sample"),
    ("time,x\n0,1\n", "t.csv: there is only one sample"),
    ("time,x\n0,1\n1,1\n2.5,1\n3.5,1\n", "t.csv:4: time: 2.5 s is 1.5 s after the sample before, others 1 s"),
    ("time,x\n0,1\n1,1\n1,1\n2,1\n", "t.csv:4: time: 1 s occurs twice"),
    ("time,x\n0,1\n1,1\n0.5,1\n", "t.csv:4: time: goes back from 1 s to 0.5 s"),
    ("t,x\n0,1\ninf,1\n1,1\n", "t.csv:3: t: should be finite, found inf"),
    (b"time,x\n0,\xff\n", "t.csv: not UTF-8 text"),
    ('time,x\n0,"1\n', "t.csv:2: not CSV: unexpected end of data"),
    (VEHICLES.replace("heading,", "h,"), "t.csv:1: column 'heading' is missing"),
    (VEHICLES.replace("x,y,", "p,q,"), "t.csv:1: columns 'x', 'y' are missing"),
    (VEHICLES.replace("11.0,1.75", "11.0,left"), "t.csv:5: y: should be a number, found 'left'"),
    (VEHICLES.replace("11.0,1.75", "11.0,NaN"), "t.csv:5: y: NaN is not a valid sample"),
    (VEHICLES.replace("11.0,1.75", "-inf,1.75"), "t.csv:5: x: should be finite, found -inf"),
    (VEHICLES.replace("11.0,1.75,0.0", "11.0,1.75,90"), "t.csv:5: heading: 90 is more than two turns"),
    (VEHICLES.replace("11.0,5.0", "11.0,6.0"), "t.csv:5: length: 'a' changes from 5 to 6 m"),
    (VEHICLES.replace("5.0,2.5", "5.0,0"), "t.csv:3: width: should be above zero, found 0"),
    (VEHICLES.replace("0.1,a", "0.0,a"), "t.csv:5: vehicle: 'a' has a second row at 0 s"),
    (VEHICLES.replace("0.1,a", "0.1,"), "t.csv:5: vehicle: the cell is empty"),
    (VEHICLES.replace("0.1,a", "0.15,a"), "t.csv:5: time: 'a' at 0.15 s lies between two samples of the ego"),
    (VEHICLES.replace("0.2,ego", "0.4,ego"), "t.csv:6: time: 0.4 s is 0.3 s after the sample before"),
    (VEHICLES.replace("ego", "car"), "t.csv: no vehicle is called 'ego'"),
]


@pytest.mark.parametrize(("text", "message"), BROKEN)
def test_every_mistake_is_one_clear_line(fails, text, message):
    found, _ = fails(text)
    assert found.startswith(message)
    assert "\n" not in found


def test_another_vehicle_at_a_far_time_is_absent(read):
    for far in ("1e308", "-1e308", "1e18"):
        found = read(VEHICLES + f"{far},a,12.0,1.75,0.0,11.0,5.0,2.5\n")
        assert found.samples == 3


@pytest.mark.parametrize(
    "times", [("0", "1e-12", "2e-12"), ("-1e308", "0", "1e308"), ("-1.5e308", "1.5e308")]
)
def test_steps_that_are_no_time_are_refused(fails, times):
    text = "time,gap\n" + "".join(f"{time},1\n" for time in times)
    message, hint = fails(text)
    assert "a step is" in message
    assert "at least a nanosecond" in hint
