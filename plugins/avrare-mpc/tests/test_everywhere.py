"""`search: everywhere`: later steps search from the initial guesses, too."""

import numpy as np
import pytest

from avrare.base.batch import concatenate
from avrare_mpc.config import MpcConfig
from avrare_mpc.controller import build
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import start_of, to_variables

BACKENDS = [
    "casadi",
    "riccati",
]
WAYS = ("follow", "everywhere")
SAMPLES = 12


@pytest.fixture(scope="module")
def steps(lane_change):
    """Return what later steps of noisy drives were given, all in one batch."""
    noise = np.array([0.3, 0.15, 0.3]) * np.random.default_rng(4).standard_normal((6, SAMPLES - 1, 3, 3))
    inputs = lane_change.drive(
        build(MpcConfig(backend="casadi", search="follow", stops=False), lane_change.scene),
        noise,
        samples=SAMPLES,
    ).inputs
    return tuple(concatenate([step[i] for step in inputs[1:]]) for i in range(3))


@pytest.fixture(scope="module", params=BACKENDS)
def outcomes(request, lane_change, steps):
    """Return memory after the same steps, of a controller that follows and of one that looks everywhere."""
    built = [build(MpcConfig(backend=request.param, search=way), lane_change.scene) for way in WAYS]
    return built, [controller.act(*steps)[1] for controller in built]


def costs(lane_change, steps, memory):
    """Return the costs of the plans, by the programme that defines them."""
    import casadi as ca

    config, (_, ego, prediction) = MpcConfig(), steps
    nlp = build_problem(config, lane_change.scene)
    cost = ca.Function("cost", [nlp.variables, nlp.parameters], [nlp.cost])
    start = start_of(ego)
    parameters = pack_parameters(lane_change.scene, start, prediction.x, prediction.y)
    plans = to_variables(memory.plan_states, memory.plan_inputs)
    return np.array([float(cost(*row)) for row in zip(plans, parameters, strict=True)])


@pytest.mark.slow
def test_plans_are_never_costlier_and_sometimes_much_cheaper(lane_change, steps, outcomes):
    follow, everywhere = (costs(lane_change, steps, memory) for memory in outcomes[1])
    assert (everywhere <= follow * (1.0 + 1e-5)).all()
    assert (everywhere < 0.9 * follow).sum() >= 2


@pytest.mark.slow
def test_it_counts_the_old_plan_and_each_initial_guess(steps, outcomes):
    follow, everywhere = ((memory.solves - steps[0].solves).tolist() for memory in outcomes[1])
    assert set(follow) == {1}
    assert set(everywhere) == {5}
