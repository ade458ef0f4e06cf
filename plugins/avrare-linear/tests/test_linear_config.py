"""Options of linear systems, and errors about them."""

import json
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare_linear.config import LinearConfig
from avrare_linear.simulator import LinearSimulator, from_config

ROOT = Path(__file__).parents[3]
GOOD = {
    "states": ["x", "v"],
    "inputs": ["a"],
    "outputs": ["seen"],
    "A": [[1, 0.1], [0, 1]],
    "B": [[0], [0.1]],
    "C": [[1, 0]],
    "process_noise": [0.0, 0.01],
    "measurement_noise": [0.04],
    "initial": {"mean": [0, 1], "covariance": [0.01, 0.01]},
    "observer": {},
    "feedback": {"gain": [[1, 2]]},
}


def config(**changes):
    data = {key: value for key, value in {**GOOD, **changes}.items() if value is not None}
    return LinearConfig.model_validate_json(json.dumps(data), strict=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": [[1, 0.1]]}, "A must be states x states, 2 x 2, not 1 x 2"),
        ({"A": [[1, 0.1], [0]]}, "A must be states x states, 2 x 2, not rows of different lengths"),
        ({"B": [[0, 1], [0.1, 1]]}, "B must be states x inputs, 2 x 1, not 2 x 2"),
        ({"C": [[1, 0, 0]]}, "C must be outputs x states, 1 x 2, not 1 x 3"),
        ({"process_noise": [0.1]}, "process_noise must be states x states, 2 x 2, not 1 x 1"),
        ({"process_noise": [[1, 0.5], [0.4, 1]]}, "process_noise must be symmetric"),
        ({"process_noise": [-1.0, 1.0]}, "process_noise has a negative variance"),
        ({"initial": {"mean": [0]}}, "initial.mean must have one number for each of the 2 states, not 1"),
        ({"reference": [[0, 1], [0]]}, "reference must have one number for each of the 2 states, not 1"),
        ({"feedforward": [1, 2]}, "feedforward must have one number for each of the 1 inputs, not 2"),
        ({"feedback": {"gain": [[1, 2], [3, 4]]}}, "feedback.gain must be inputs x states, 1 x 2, not 2 x 2"),
        ({"feedback": {}}, "give either gain, or state_cost and input_cost"),
        ({"feedback": {"state_cost": [1, 1]}}, "give either gain, or state_cost and input_cost"),
        ({"observer": {"gain": [[1, 2]]}}, "observer.gain must be states x outputs, 2 x 1, not 1 x 2"),
        ({"outputs": [], "C": None, "measurement_noise": None}, "observer needs outputs and C"),
        ({"inputs": [], "B": None}, "feedback needs inputs and B"),
        ({"B": None}, "give inputs and B together"),
        ({"C": None}, "give outputs and C together"),
        ({"states": ["x", "x"]}, "different names"),
        ({"states": ["x", "2v"]}, "'2v' is not a valid signal name"),
        ({"outputs": ["x_estimate"]}, "different names"),
        ({"A": [[1, "one"], [0, 1]]}, "'one' is not a number"),
        ({"process_noise": [0.1, True]}, "True is not a number"),
        ({"A": [[1, [1]], [0, 1]]}, "valid number"),
        ({"A": 3}, "valid array"),
        ({"dt": 0}, "greater than 0"),
        ({"colour": "red"}, "Extra inputs"),
    ],
)
def test_wrong_options_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        config(**changes)


def test_a_matrix_stands_for_all_steps_and_a_vector_for_a_diagonal():
    one = config(process_noise=[0.25, 1.0])
    assert one.A == (((1, 0.1), (0, 1)),)
    assert one.process_noise == (((0.25, 0), (0, 1)),)
    assert len(config(A=[GOOD["A"], GOOD["A"]]).A) == 2
    assert LinearConfig.model_validate_json(one.model_dump_json(), strict=True) == one


def test_signals_have_the_names_of_the_scenario():
    simulator = LinearSimulator(config())
    world = simulator.reset(np.zeros((3, simulator.noise_size)))
    names = ("x", "v", "x_estimate", "v_estimate", "a", "seen")
    assert tuple(simulator.signals(world)) == config().names == names


def test_a_controller_of_another_plugin_is_refused():
    simulator = LinearSimulator(config())
    world = simulator.reset(np.zeros((1, 3)))
    with pytest.raises(avrare.UsageError, match="controller of its own"):
        simulator.step(world, object(), np.zeros((1, 3)))


def test_an_invalid_covariance_is_refused_when_the_system_is_built():
    with pytest.raises(avrare.UsageError, match="process_noise is not a covariance"):
        from_config(config(process_noise=[[1.0, 2.0], [2.0, 1.0]]))


def test_an_input_without_effect_has_no_optimal_gain():
    costs = {"state_cost": [1, 1], "input_cost": [1]}
    with pytest.raises(avrare.UsageError, match="feedback: no optimal gain exists"):
        from_config(config(A=[[2, 0], [0, 2]], B=[[0], [0]], feedback=costs))


def test_the_scenario_of_the_repository_loads_and_runs():
    problem = avrare.load(ROOT / "scenarios" / "double_integrator.yaml").problem("clear")
    nominal = problem.nominal()
    assert problem.steps == 50
    assert not nominal.violated[0, 0]
    assert nominal.robustness[0, 0] == pytest.approx(0.55, abs=0.01)
