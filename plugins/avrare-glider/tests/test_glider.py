"""The glider: physics against a textbook form, derivatives, gains, the nominal flight, rows, scenarios."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import avrare
from avrare_glider import aircraft
from avrare_glider.config import FeedbackConfig, GliderConfig
from avrare_glider.feedback import gains, linearise
from avrare_glider.nominal import Flight, nominal
from avrare_glider.simulator import GliderSimulator

SCENARIOS = Path(__file__).parents[3] / "scenarios"
RNG = np.random.default_rng(5)
NOISY = {"x": 0.001, "z": 0.02, "actuator": 0.3}


def glider(**options):
    return GliderSimulator(GliderConfig.model_validate(options))


def drive(simulator, tape):
    world = simulator.reset(tape[:, 0])
    worlds = [world]
    for t in range(1, tape.shape[1]):
        world = simulator.step(world, None, tape[:, t])
        worlds.append(world)
    return worlds


def by_lift_and_drag(state, rate):
    """Return rates from lift 2 sin cos and drag 2 sin^2 of each plate, forces and moment arms as vectors."""
    _, _, pitch, elevator, vx, vz, turn = state
    v = np.array([vx, vz])
    both = pitch + elevator
    arm = -0.27 * np.array([np.cos(pitch), np.sin(pitch)]) - 0.022 * np.array([np.cos(both), np.sin(both)])
    tail = v + 0.27 * turn * np.array([np.sin(pitch), -np.cos(pitch)])
    tail += 0.022 * (turn + rate) * np.array([np.sin(both), -np.cos(both)])
    forces = []
    for area, angle, air in ((0.0885, pitch, v), (0.0147, both, tail)):
        attack = angle - np.arctan2(air[1], air[0])
        speed = np.linalg.norm(air)
        pressure = 0.5 * 1.204 * speed**2 * area
        lift = pressure * 2 * np.sin(attack) * np.cos(attack) * np.array([-air[1], air[0]]) / speed
        drag = -pressure * 2 * np.sin(attack) ** 2 * air / speed
        forces.append(lift + drag)
    acceleration = (forces[0] + forces[1]) / 0.08 - np.array([0.0, 9.81])
    moment = arm[0] * forces[1][1] - arm[1] * forces[1][0]
    return np.array([vx, vz, turn, rate, *acceleration, moment / 0.0015])


@pytest.mark.parametrize("i", range(5))
def test_the_plates_have_the_lift_and_drag_of_flat_plates(i):
    rng = np.random.default_rng(i)
    state = rng.normal(size=7) * (1, 1, 1, 0.5, 2, 2, 3) + (0, 0, 0, 0, 4, 0, 0)
    rate = float(rng.normal() * 5)
    ours = aircraft.rates(tuple(state), rate)
    np.testing.assert_allclose(ours, by_lift_and_drag(state, rate), rtol=1e-9, atol=1e-9)


def test_the_nominal_flight_is_the_published_problem_solved():
    flight = nominal()
    assert flight.states.shape == (67, 7)
    np.testing.assert_array_equal(flight.states[0], aircraft.START)
    np.testing.assert_allclose(flight.states[-1, :2], 0.0, atol=1e-3)
    assert np.pi / 6 <= flight.states[-1, 2] <= 1.0 + 1e-3
    assert (np.abs(flight.states[-1, 4:6]) <= 2.0 + 1e-3).all()
    assert (np.abs(flight.inputs) <= aircraft.RATE_LIMIT).all()
    low, high = aircraft.ELEVATOR_STOPS
    assert low <= flight.states[:, 3].min() <= flight.states[:, 3].max() <= high
    assert np.rad2deg(flight.states[:, 2]).max() > 45  # far beyond the stall


def test_the_optimiser_reproduces_the_nominal_flight():
    from glider_nominal_flight import optimise

    np.testing.assert_allclose(optimise().inputs, nominal().inputs, atol=1e-4)


def test_derivatives_agree_with_differences():
    flight = nominal()
    a, b = linearise(flight)
    for t in (0, 30, 65):
        state = np.append(flight.states[t], flight.inputs[t])

        def after(values):
            return np.array(aircraft.advance(tuple(values[:7]), values[7]))

        slopes = [(after(state + h) - after(state - h)) / 2e-6 for h in 1e-6 * np.eye(8)]
        np.testing.assert_allclose(np.c_[a[t], b[t]], np.transpose(slopes), atol=2e-7)


def test_gains_are_the_optimum_of_their_cost():
    """Compare the cost of the linearised errors from a start with that of any other gain at one step."""
    flight = Flight(nominal().states[:13], nominal().inputs[:12])
    cost = FeedbackConfig()
    (a, b), best = linearise(flight), gains(flight, cost)

    def paid(gain):
        error, total = np.array([0.01, 0.02, 0.03, -0.01, 0.1, -0.1, 0.05]), 0.0
        for t in range(12):
            change = -gain[t] @ error
            total += 0.01 * (error @ (cost.state_cost * error) + cost.input_cost * change**2)
            error = a[t] @ error + b[t] * change
        return total + error @ (cost.final_cost * error)

    for t in (0, 6, 11):
        for i in range(7):
            for shift in (-0.5, 0.5):
                other = best.copy()
                other[t, i] += shift
                assert paid(other) > paid(best)


def test_without_noise_it_flies_the_nominal_flight():
    simulator = glider(noise=NOISY)
    worlds = drive(simulator, np.zeros((1, 67, 2)))
    flown = np.array([world.motion for world in worlds])[:, :, 0]
    np.testing.assert_allclose(flown, nominal().states, atol=1e-12)


def test_feedback_corrects_deviations():
    tape = RNG.standard_normal((50, 67, 2))
    ends = [drive(glider(noise=NOISY, **more), tape)[-1].motion for more in ({}, {"feedback": None})]
    near, far = (np.abs(motion[1]).mean() for motion in ends)
    assert near < 0.2 * far


def test_noise_is_as_the_readme_describes():
    simulator = glider(noise=NOISY, feedback=None)
    tape = np.zeros((3, 2, 2))
    tape[0, 0], tape[1, 1, 0], tape[2, 1, 1] = (1.5, -2.0), 1.0, 9.0
    first, second = drive(simulator, tape)
    assert first.motion[0] - aircraft.START[0] == pytest.approx([0.0015, 0.0, 0.0])
    assert first.motion[1] - aircraft.START[1] == pytest.approx([-0.04, 0.0, 0.0])
    assert second.motion[3] - 0.01 * nominal().inputs[0] == pytest.approx([0.0, 0.003, 0.0])


def test_the_servo_has_its_limits():
    simulator = glider(noise={"actuator": 1000.0})
    tape = np.ones((2, 80, 1))
    tape[1] *= -1.0
    elevator = np.array([world.motion[3] for world in drive(simulator, tape)])
    low, high = aircraft.ELEVATOR_STOPS
    assert np.abs(np.diff(elevator, axis=0)).max() == pytest.approx(0.13)
    np.testing.assert_allclose(elevator[-1], [high, low], atol=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"noise": {"x": -1.0}}, {"noise": {"y": 1.0}}, {"feedback": {"input_cost": 0.0}},
        {"feedback": {"state_cost": [1, 2, 3]}}, {"feedback": {"final_cost": [1, 1, 1, 1, 1, 1, -1]}},
    ],
)  # fmt: skip
def test_wrong_options_are_refused(wrong):
    with pytest.raises(ValidationError):
        GliderConfig.model_validate(wrong)


@pytest.mark.parametrize("name", ["glider", "glider_actuator"])
def test_scenarios_perch_without_noise_and_fail_with_a_push(name):
    problem = avrare.load(SCENARIOS / f"{name}.yaml").problem("perches")
    nominal_run = problem.nominal()
    assert not nominal_run.violated.any()
    assert nominal_run.robustness[0, 0] > 0.04
    tape = np.zeros((1, 67, problem.noise_size))
    tape[0, 0] = -6.0
    tape[0, 1:20] = -3.0
    assert problem.robustness(tape)[0] < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glider", "glider_actuator"])
def test_slices_and_monte_carlo_agree(name):
    more = ["simulator.noise.actuator=0.5"] if name == "glider_actuator" else ["simulator.noise.z=0.024"]
    problem = avrare.load(SCENARIOS / f"{name}.yaml", more).problem("perches")
    plain = avrare.estimate(problem, "mc", seed=1, rollouts=6000)
    slices = avrare.estimate(problem, "ess", seed=1, chains=30, runs=8)
    assert plain.probability > 0.01
    low, high = plain.interval_at(0.999)
    assert slices.interval_at(0.999)[0] < high
    assert slices.interval_at(0.999)[1] > low
