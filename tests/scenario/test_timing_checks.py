"""Times of a stack against the simulator's step and the length of a drive, without building anything."""

import pytest

TIMED = "timing:\n  planner_period: {planner}\n  perception_latency: {latency}\n"


@pytest.fixture
def timed(good):
    """Return the text of a scenario of 4 s with these times in its last lines."""

    def write(planner=0.2, latency=0.1):
        return good + TIMED.format(planner=planner, latency=latency)

    return write


def test_a_period_between_steps_is_an_error_at_its_place(fails, timed):
    line = timed().splitlines().index("timing:") + 2
    lines, code = fails(timed(planner=0.25))
    assert code == 4
    assert lines == [
        f"s.yaml:{line}:19: timing.planner_period: 0.25 s is not a multiple of the simulator's step, 0.1 s",
        "hint: such as 0.2",
    ]


def test_periods_that_do_not_fit_each_other_are_an_error(fails, good):
    lines, _ = fails(f"{good}timing: {{sensor_period: 0.2, tracker_period: 0.3}}\n")
    assert "timing.tracker_period: 0.3 s is not a multiple of sensor_period, 0.2 s" in lines[0]


@pytest.mark.parametrize(
    ("times", "text"),
    [
        (
            {"planner": 4.0},
            "planner_period: 4 s is not shorter than the drive, 4 s: it has a single plan",
        ),
        (
            {"latency": 5},
            "perception_latency: 5 s is not shorter than the drive, 4 s: none of its frames",
        ),
    ],
)
def test_a_time_as_long_as_the_drive_is_a_warning(read, timed, times, text):
    [(message, hint)] = read(timed(**times)).warnings
    assert text in message
    assert message.startswith("s.yaml:")
    assert hint is None


def test_times_within_the_drive_are_not_warned_of(read, timed):
    assert read(timed(planner=3.9, latency=3.95)).warnings == ()
