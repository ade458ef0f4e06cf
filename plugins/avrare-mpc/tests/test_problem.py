"""The programme against the reference cost, written again in NumPy, its selectors found numerically."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from avrare_mpc.casadi_search import NlpSolver
from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import build_problem, lane_cost, pack_parameters, softplus
from avrare_mpc.plan import shift, start_of, to_variables

LANES = (1.75, 5.25)


def selected(y, lanes):
    """Return min over the simplex of sum((s d)^2), by a general solver."""
    distances = np.array([y - lane for lane in lanes])
    found = minimize(
        lambda s: np.sum((s * distances) ** 2),
        np.full(len(lanes), 1.0 / len(lanes)),
        bounds=[(0.0, 1.0)] * len(lanes),
        constraints={"type": "eq", "fun": lambda s: s.sum() - 1.0},
        options={"ftol": 1e-14, "maxiter": 300},
    )
    return found.fun


def overrun(value):
    return np.logaddexp(0.0, 10.0 * value) / 10.0


def reference_cost(config, scene, states, inputs, others_x, others_y):
    """Compute it section by section, with free inputs (0, c / (c + r) w) at the last node."""
    rate, change = config.turn_rate_weight, config.turn_rate_change_weight
    a = np.append(inputs[:, 0], 0.0)
    w = np.append(inputs[:, 1], change / (change + rate) * inputs[-1, 1])
    x, y, v, h = states.T
    dt = scene.dt
    total = 25 * np.sum((y - 1.75) ** 2) + np.sum((v - 31.29) ** 2)
    total += 50 * np.sum(a**2) + 200 * np.sum(np.minimum(0, a) ** 2)
    total += 0.1 * np.sum(w**2) + 10 * np.sum(np.diff(w) ** 2)
    total += 5 * sum(selected(lateral, LANES) for lateral in y)
    lead = a if config.lateral_lead == "acceleration" else v
    for i in range(3):
        size_x = scene.lengths[i] / 2 + 1.5 * scene.ego_length + v * np.cos(h) * dt + a * np.cos(h) * dt**2
        size_y = scene.widths[i] / 2 + scene.ego_width + 1.5 + v * np.sin(h) * dt + lead * np.sin(h) * dt**2
        missing_x = overrun(size_x + 3.0 - np.abs(x - others_x[i]))
        missing_y = overrun(size_y - np.abs(y - others_y[i]))
        total += 500 * np.sum(np.minimum(missing_x, missing_y) ** 2)
    return total


@pytest.mark.parametrize("lead", ["acceleration", "speed"])
def test_cost_equals_the_reference_cost(lane_change, lead):
    config, scene, rng = MpcConfig(lateral_lead=lead), lane_change.scene, np.random.default_rng(1)
    nlp = build_problem(config, scene)
    cost = ca.Function("cost", [nlp.variables, nlp.parameters], [nlp.cost])
    for _ in range(12):
        spread = [20.0, 1.5, 3.0, 0.2]
        states = np.array([40.0, 3.5, 20.0, 0.0]) + spread * rng.standard_normal((21, 4))
        inputs = [2.0, 0.3] * rng.standard_normal((20, 2))
        others = rng.uniform(20, 60, (3, 21)), rng.uniform(-2, 6, (3, 21))
        parameters = pack_parameters(
            scene, np.append(states[0], 0.0)[None], others[0][None], others[1][None]
        )[0]
        ours = float(cost(to_variables(states, inputs), parameters))
        assert ours == pytest.approx(reference_cost(config, scene, states, inputs, *others), rel=1e-7)


@pytest.mark.parametrize("lanes", [(1.75,), LANES, (-1.75, 1.75, 5.25)])
def test_lane_cost_is_the_best_relaxed_selection(lanes):
    y = ca.SX.sym("y")
    ours = ca.Function("lane", [y], [lane_cost(y, lanes), ca.gradient(lane_cost(y, lanes), y)])
    for lateral in (-3.0, 0.3, 2.0, 3.5, 5.0, *lanes):
        value, slope = (float(part) for part in ours(lateral))
        assert value == pytest.approx(selected(lateral, lanes), abs=1e-6)
        assert np.isfinite(slope)


def test_softplus_neither_overflows_nor_loses_small_values():
    u = ca.SX.sym("u")
    ours = ca.Function("softplus", [u], [softplus(u, 10.0), ca.gradient(softplus(u, 10.0), u)])
    for value in (-300.0, -3.0, -0.01, 0.02, 3.0, 300.0):
        found, slope = (float(part) for part in ours(value))
        assert found == pytest.approx(overrun(value), rel=1e-12, abs=1e-300)
        assert slope == pytest.approx(0.5 * (1.0 + np.tanh(5.0 * value)), abs=1e-12)


def programmes(lane_change, drive):
    """Guess and parameters of every step but the first of a drive."""
    for memory, ego, prediction in drive.inputs[1:]:
        start = start_of(ego)
        parameters = pack_parameters(lane_change.scene, start, prediction.x, prediction.y)
        guess = to_variables(*shift(memory.plan_states, memory.plan_inputs, lane_change.scene.dt))
        yield from zip(guess, parameters, strict=True)


def test_fatrop_finds_the_minimum_of_tight_ipopt(lane_change, quiet):
    # with a stronger penalty ipopt leaves the basin it starts in while its slacks are still large
    nlp = build_problem(MpcConfig(y_penalty=1e4), lane_change.scene)
    fatrop = NlpSolver(nlp, "fatrop")
    problem = {"x": nlp.variables, "p": nlp.parameters, "f": nlp.cost, "g": nlp.constraints}
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}}
    ipopt = ca.nlpsol("tight", "ipopt", problem, options)
    ratios, differences = [], []
    for guess, parameters in programmes(lane_change, quiet[1]):
        ours = fatrop.solve(guess, parameters)
        theirs = ipopt(x0=guess, p=parameters, lbg=nlp.lower, ubg=nlp.upper)
        assert ipopt.stats()["success"]
        assert not ours.retried
        ratios.append(ours.cost / float(theirs["f"]) - 1.0)
        differences.append(np.abs(ours.variables - theirs["x"].full().ravel())[5:7].max())
    assert len(ratios) == 38
    assert np.abs(ratios).max() < 1e-8
    assert max(differences) < 1e-6


@pytest.mark.parametrize("name", ["fatrop", "ipopt"])
def test_a_solver_has_no_memory(lane_change, quiet, name):
    solver = NlpSolver(build_problem(MpcConfig(), lane_change.scene), name)
    cases = list(programmes(lane_change, quiet[1]))[::4]
    forwards = [solver.solve(*case) for case in cases]
    solver.solve(cases[0][0] * 1e6, cases[0][1])
    backwards = [solver.solve(*case) for case in reversed(cases)][::-1]
    fresh = NlpSolver(build_problem(MpcConfig(), lane_change.scene), name).solve(*cases[3])
    for one, two in zip(forwards, backwards, strict=True):
        assert np.array_equal(one.variables, two.variables)
        assert one.cost == two.cost
    assert np.array_equal(fresh.variables, forwards[3].variables)
