"""Latency, periods, losses and actuators around the parts of a loop, against shifts and closed forms."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from avrare import UsageError
from avrare.base import batch
from avrare.driving import Action, Observation, Prediction, Road, Scene, Vehicles
from avrare.protocols import Controller, PerceptionErrorModel, Tracker, adapt
from avrare.scenario.timing import Actuators, Timing
from avrare.stack.builder import Parts, time_parts
from avrare.stack.clock import Clock, move_samples
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.timed_controller import Response

DT, STEPS = 0.1, 24
SCENE = Scene(DT, Road((0.0,), 3.5), 4.5, 1.8, ("lead",), np.full(1, 4.5), np.full(1, 1.8), np.ones(1, bool))


@dataclass(frozen=True)
class Drive:
    ego: Vehicles
    others: Vehicles
    step: np.ndarray


class Highway:
    """The ego does what it is asked for; the lead's x is the square of the time in tenths of a second."""

    scene, noise_size = SCENE, 0

    def __init__(self, dt=DT):
        self.dt = dt

    def reset(self, noise):
        zero = np.zeros(len(noise))
        return Drive(Vehicles(zero, zero, zero, zero + 20.0, zero), self._lead(zero), zero)

    def step(self, world, action, noise):
        a, ego, dt = action.acceleration, world.ego, self.dt
        x, speed = ego.x + dt * (ego.speed + 0.5 * dt * a), ego.speed + dt * a
        moved = dataclasses.replace(ego, x=x, speed=speed, acceleration=a)
        return Drive(moved, self._lead(world.step + 1.0), world.step + 1.0)

    def _lead(self, step):
        zero = 0.0 * step[:, None]
        return Vehicles((step[:, None] * (self.dt / DT)) ** 2, zero, zero, zero, zero)

    def signals(self, world):
        return {"speed": world.ego.speed, "acceleration": world.ego.acceleration, "x": world.ego.x}


class Sensor:
    """Sees the lead with an error of the size of the noise."""

    noise_size = 1

    def observe(self, world, noise):
        x = world.others.x
        return Observation(np.ones(x.shape, bool), x + noise, 0.0 * x, 0.0 * x)


class Last:
    """Tracker: the last detection, or -1 after a miss; the prediction moves at 10 m per step."""

    def start(self, world):
        return np.zeros_like(world.others.x)

    def update(self, track, observation):
        return np.where(observation.detected, observation.x, -1.0)

    def predict(self, track, steps):
        x = track[..., None] + 10.0 * np.arange(steps + 1)
        return Prediction(x, 0.0 * x)


class Copies:
    """Controller: asks for what it hears of the lead, and remembers where it was told to be."""

    horizon = 2

    def start(self, n):
        return {"heard": np.zeros(n), "x": np.zeros(n)}

    def act(self, memory, ego, prediction):
        heard = prediction.x[:, 0, 0]
        return Action(heard, 0.0 * heard), {"heard": heard, "x": ego.x}


def make_parts(perception):
    return Parts(adapt(PerceptionErrorModel, perception), adapt(Tracker, Last()), adapt(Controller, Copies()))


def loop(actuators=None, perception=None, dt=DT, **timing):
    chosen, parts = Timing(**timing), make_parts(perception or Sensor())
    clock = Clock.of(chosen, dt)
    return ClosedLoop(Highway(dt), *time_parts(chosen, actuators or Actuators(), clock, SCENE, parts))


def drive(system, seed=None, n=1):
    """Return the states of ``n`` drives, by step, without noise or with that of a seed."""
    tape = np.zeros((STEPS + 1, n, system.noise_size))
    if seed is not None:
        tape = np.random.default_rng(seed).standard_normal(tape.shape)
    states = [system.initial(tape[0])]
    for row in tape[1:]:
        states.append(system.step(states[-1], row))
    return states


def heard(system, **options):
    """Return what the controller asked for at each step (T,), before any delay of its commands."""
    return np.array([system.predict(state).x[0, 0, 0] for state in drive(system, **options)[:-1]])


def done(system, **options):
    """Return what the ego did in each step (T,)."""
    return np.array([state.world.ego.acceleration[0] for state in drive(system, **options)[1:]])


TRUTH = np.arange(STEPS) ** 2.0


@pytest.mark.parametrize("steps", [1, 3])
def test_a_latency_shifts_what_is_heard(steps):
    late = heard(loop(perception_latency=steps * DT))
    np.testing.assert_array_equal(late[1 + steps :], TRUTH[1:-steps])
    np.testing.assert_array_equal(late[1 : 1 + steps], -1.0)  # nothing has arrived


@pytest.mark.parametrize("option", ["planning_latency", "actuation_delay"])
@pytest.mark.parametrize("steps", [1, 3])
def test_a_delay_shifts_what_is_done(option, steps):
    late = done(loop(**{option: steps * DT}))
    np.testing.assert_array_equal(late[steps:], TRUTH[:-steps])
    np.testing.assert_array_equal(late[:steps], 0.0)


def test_a_plan_is_kept_until_the_next_one():
    kept = done(loop(planner_period=0.3))
    np.testing.assert_array_equal(kept, TRUTH[3 * (np.arange(STEPS) // 3)])


def test_a_tracker_between_its_updates_predicts():
    system = loop(sensor_period=0.2)
    last = 2 * (np.arange(STEPS) // 2)
    # half a step of the tracker after its update, which is 10 m in its prediction
    np.testing.assert_array_equal(heard(system), last**2.0 + 5.0 * (np.arange(STEPS) % 2))


def test_a_stack_with_periods_is_the_same_at_half_the_step():
    times = {"perception_latency": 0.1, "planning_latency": 0.1, "actuation_delay": 0.1}
    times |= {"sensor_period": DT, "planner_period": DT, "compensated": True}
    runs = []
    for halves in (1, 2):
        system = loop(dt=DT / halves, **times)
        states = [system.initial(np.zeros((1, 1)))]
        for _ in range(halves * STEPS):
            states.append(system.step(states[-1], np.zeros((1, 1))))
        runs.append(np.array([[s.world.ego.x[0], s.world.ego.speed[0]] for s in states[::halves]]))
    np.testing.assert_allclose(runs[0], runs[1])


def test_a_prediction_is_moved_between_its_samples():
    x = np.array([[[0.0, 1.0, 4.0, 9.0], [np.inf] * 4]])
    moved = move_samples(Prediction(x, -x), 0.5, 1.25, 2)
    np.testing.assert_allclose(moved.x[0, 0], [0.5, 3.25, 9.0])
    assert np.isinf(moved.x[0, 1]).all()
    np.testing.assert_array_equal(moved.y, -moved.x)


def test_a_frame_is_read_when_it_has_arrived_unless_a_newer_one_was():
    system = loop(perception_jitter=0.1)
    error, lateness = np.random.default_rng(3).standard_normal((STEPS + 1, 1, 2))[:, 0].T
    arrival = np.arange(STEPS + 1) + np.ceil(np.maximum(lateness, 0.0))
    arrival[0], read, expected = np.inf, 0, []
    for now in range(1, STEPS):
        arrived = [frame for frame in range(read + 1, now + 1) if arrival[frame] <= now]
        read = max(arrived, default=read)
        expected.append(read**2 + error[read] if arrived else -1.0)
    assert 0.2 < expected.count(-1.0) / STEPS < 0.7
    np.testing.assert_allclose(heard(system, seed=3)[1:], expected)


def test_late_frames_are_moved_on_at_their_speed_where_their_time_is_known():
    class Speeds(Sensor):
        def observe(self, world, noise):
            seen = super().observe(world, 0.0 * noise)
            return dataclasses.replace(seen, speed_x=20.0 * world.others.x**0.5)

    system = loop(perception=Speeds(), perception_jitter=0.1, compensated=True)
    late = np.ceil(np.maximum(np.random.default_rng(3).standard_normal((STEPS + 1, 1, 2))[:, 0, 1], 0.0))
    read = heard(system, seed=3)[1:]
    frames = [frame for frame in range(1, STEPS) if late[frame] == 1.0]
    expected = {frame**2.0 + 2.0 * frame for frame in frames}
    assert {value for value in read if value != -1.0 and value not in TRUTH} <= expected
    assert expected & set(read) == {288.0, 323.0}


def test_lost_frames_and_missed_cycles_are_as_frequent_as_they_should_be():
    n = 400
    lossy = loop(lost_frames=0.3)
    states = drive(lossy, seed=0, n=n)[1:]
    seen = np.mean([state.observation.detected.mean() for state in states])
    assert abs(seen - 0.7) < 4 * np.sqrt(0.21 / (n * STEPS))
    missing = loop(missed_cycles=0.3)
    state = drive(missing, seed=0, n=n)[-1]
    missed = missing.counts(state)["missed_cycles"].mean() / STEPS
    assert abs(missed - 0.3) < 4 * np.sqrt(0.21 / (n * STEPS))


def test_a_missed_cycle_keeps_command_and_memory():
    system = loop(missed_cycles=0.5)
    state = drive(system)[3]
    noise = np.array([[0.0, -1.0], [0.0, 1.0]])
    pair = system.step(batch.take(state, np.zeros(2, int)), noise)
    np.testing.assert_array_equal(pair.world.ego.acceleration, [4.0, 9.0])
    np.testing.assert_array_equal(pair.memory.planner["heard"], [4.0, 9.0])


def test_a_lag_is_that_of_continuous_time():
    tau, wanted, dt = 0.25, 3.0, 0.1
    response = Response(Actuators(acceleration_lag=tau, turn_lag=2 * tau), dt)
    level, command = Action(np.zeros(1), np.zeros(1)), Action(np.full(1, wanted), np.full(1, -wanted))
    speed = course = 0.0
    for step in range(1, 12):
        mean, level = response.follow(level, command, np.full(1, 20.0))
        speed, course = speed + dt * mean.acceleration[0], course + dt * mean.yaw_rate[0]
        ends = (level.acceleration, speed, tau, 1), (level.yaw_rate, course, 2 * tau, -1)
        for reached, total, size, sign in ends:
            rest = np.exp(-step * dt / size)
            np.testing.assert_allclose(reached[0], sign * wanted * (1 - rest))
            np.testing.assert_allclose(total, sign * wanted * (step * dt - size * (1 - rest)))


def test_jerk_and_power_are_bounded():
    response = Response(Actuators(jerk_max=20.0, power_max=40.0), DT)
    level, command = Action(np.zeros(2), np.zeros(2)), Action(np.array([3.0, -6.0]), np.ones(2))
    levels = []
    for _ in range(5):
        mean, level = response.follow(level, command, np.full(2, 25.0))
        levels.append(level.acceleration)
    np.testing.assert_allclose(np.array(levels)[:, 0], 1.6)  # 40 W/kg at 25 m/s
    np.testing.assert_allclose(np.array(levels)[:, 1], [-2.0, -4.0, -6.0, -6.0, -6.0])
    np.testing.assert_array_equal(mean.yaw_rate, 1.0)


def test_a_planner_that_knows_the_delay_plans_from_where_the_ego_will_be():
    system = loop(planning_latency=0.1, actuation_delay=0.1, compensated=True)
    states = drive(system)
    for now, later in zip(states[3:-2], states[5:], strict=True):
        planned_from = system.step(now, np.zeros((1, 1))).memory.planner["x"]
        np.testing.assert_allclose(planned_from, later.world.ego.x)
    # and asks for the lead of two steps later, by the tracker's prediction
    np.testing.assert_array_equal(done(system)[2:], TRUTH[:-2] + 20.0)


ALL = {"sensor_period": 0.2, "perception_latency": 0.15, "perception_jitter": 0.1, "lost_frames": 0.1}
ALL |= {"planner_period": 0.2, "planning_latency": 0.1, "missed_cycles": 0.2, "actuation_delay": 0.1}


@pytest.mark.parametrize("start", [0, 1, 8])
def test_rows_of_a_batch_and_branches_have_the_bits_of_the_whole(start):
    system = loop(Actuators(acceleration_lag=0.2, jerk_max=100.0), compensated=True, **ALL)
    whole, rows = drive(system, seed=1, n=6), np.array([4, 1])
    tape = np.random.default_rng(1).standard_normal((STEPS + 1, 6, system.noise_size))
    state = batch.take(whole[start], rows)
    for t in range(start + 1, STEPS + 1):
        state = system.step(state, tape[t, rows])
        for leaf, expected in zip(batch.leaves(state), batch.leaves(batch.take(whole[t], rows)), strict=True):
            np.testing.assert_array_equal(leaf, expected)


def test_noise_is_named_and_perfect_noise_is_on_time():
    system = loop(perception_jitter=0.1, lost_frames=0.1, missed_cycles=0.1)
    assert system.noise_names[1:] == ("lateness of frames", "loss of frames", "loss of planning cycles")
    assert system.noise_size == len(system.noise_names) == len(system.perfect_noise)
    np.testing.assert_array_equal(heard(system), TRUTH)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"planning_latency": 0.15}, "planning_latency: 0.15 s is not a multiple"),
        ({"sensor_period": 0.2, "tracker_period": 0.3}, "not a multiple of sensor_period"),
    ],
)
def test_times_that_no_step_meets_are_refused(options, text):
    with pytest.raises(UsageError, match=text):
        loop(**options)


def test_options_of_a_part_that_is_not_there_are_refused():
    clock = Clock(DT)
    nothing = Parts(None, None, None)
    with pytest.raises(UsageError, match="perception_latency needs a tracker"):
        time_parts(Timing(perception_latency=0.1), Actuators(), clock, SCENE, nothing)
    with pytest.raises(UsageError, match="actuators: needs a controller"):
        time_parts(Timing(), Actuators(turn_lag=0.1), clock, SCENE, nothing)
