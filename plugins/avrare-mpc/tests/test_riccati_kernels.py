"""Derivatives and the Riccati recursion, against differences and dense linear algebra; not compiled."""

import casadi as ca
import numpy as np
import pytest

from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import to_variables
from avrare_mpc.riccati.solver import programme

VARIANTS = {
    "reference": {},
    "lead": {"lateral_lead": "speed", "heading_weight": 3.0},
    "three lanes": {"lanes": [0, 1, 2], "turn_rate_change_weight": 2000.0},
    "lateral": {"lateral_acceleration_max": 20.0},
    "one lane": {"lanes": [1], "sharpness": 3.0, "turn_rate_weight": 0.0, "turn_rate_change_weight": 0.0},
}


@pytest.fixture(params=list(VARIANTS))
def config(request):
    return MpcConfig.model_validate({"horizon": 8, **VARIANTS[request.param]})


@pytest.fixture
def drawn(config, lane_change, plain):
    """A programme and a random path in the thick of it, with its barrier at 0.5."""
    rng, p = np.random.default_rng(4), programme(config, lane_change.scene)
    path = plain.values.new_path(config.horizon, 3)
    path.states[0] = [30.0, 3.3, 21.0, 0.1]
    path.inputs[:] = [2.0, 0.2] * rng.standard_normal((config.horizon, 2))
    shape = (3, config.horizon + 1)
    others = plain.values.Others(rng.uniform(28, 55, shape), rng.uniform(-1, 6, shape))
    plain.newton.simulate(p, path)
    plain.cost.path_cost(p, path, others)
    plain.cost.barrier(p, path, every_bound(plain, config), 0.5)
    return p, path, others


def every_bound(plain, config):
    return plain.values.Bounds(hard=4 if config.lateral_acceleration_max is None else 6, soft=3)


def copy(plain, path):
    return plain.values.Path(*(part.copy() for part in path))


def test_cost_and_model_are_those_of_the_programme(config, lane_change, plain, drawn):
    p, path, others = drawn
    nlp = build_problem(config, lane_change.scene)
    cost = ca.Function("cost", [nlp.variables, nlp.parameters], [nlp.cost])
    parameters = pack_parameters(lane_change.scene, path.states[:1], others[0][None], others[1][None])[0]
    expected = float(cost(to_variables(path.states, path.inputs), parameters))
    assert plain.cost.path_cost(p, path, others) == pytest.approx(expected, rel=1e-12)
    dynamics = ca.Function("gaps", [nlp.variables, nlp.parameters], [nlp.constraints])
    gaps = np.asarray(dynamics(to_variables(path.states, path.inputs), parameters)).ravel()
    assert np.abs(gaps[nlp.lower == nlp.upper]).max() < 1e-12


def test_slacks_are_the_least(plain):
    for gap in (-2.0, -1e-9, 0.0, 1e-9, 3.0):
        inside, outside = plain.cost.slacks(gap, 1e5, 1e-3)
        assert inside - outside == pytest.approx(gap, abs=1e-12)
        assert 1e-3 / inside + 1e-3 / outside == pytest.approx(1e5, rel=1e-9)


def moved(plain, p, path, others, centre):
    """A copy whose node 0 is at ``centre`` (x, y, v, h, a), the other nodes as they are, and its cost."""
    there = copy(plain, path)
    there.states[0], there.inputs[0, 0] = centre[:4], centre[4]
    there.cosine[0], there.sine[0] = np.cos(centre[3]), np.sin(centre[3])
    return there, plain.cost.path_cost(p, there, others)


def test_stage_gradient_is_that_of_the_cost(plain, drawn):
    p, path, others = drawn
    centre, step = np.array([*path.states[0], path.inputs[0, 0]]), 1e-5
    model = plain.cost.stage_model(p, path, 0, centre[4], others)
    for name, axis in zip("xyvha", np.eye(5), strict=True):
        ahead, behind = (moved(plain, p, path, others, centre + sign * step * axis)[1] for sign in (1, -1))
        assert getattr(model, name) == pytest.approx((ahead - behind) / (2 * step), rel=1e-6, abs=1e-4)


def test_stage_hessian_is_exact_where_the_clearances_are_linear(plain, drawn):
    """That is, at a fixed heading; the lanes are left out, their curvature is Gauss-Newton's."""
    p, path, others = drawn
    p, step = p._replace(lane_weight=0.0), 1e-6
    centre = np.array([*path.states[0], path.inputs[0, 0]])
    model = plain.cost.stage_model(p, path, 0, centre[4], others)
    for name in ("xx", "xv", "xa", "yy", "yv", "ya", "vv", "va", "aa"):
        axis, slopes = np.eye(5)["xyvha".index(name[1])], []
        for sign in (1.0, -1.0):
            there, _ = moved(plain, p, path, others, centre + sign * step * axis)
            slopes.append(getattr(plain.cost.stage_model(p, there, 0, there.inputs[0, 0], others), name[0]))
        assert getattr(model, name) == pytest.approx((slopes[0] - slopes[1]) / (2 * step), rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("along", [True, False])
def test_the_clearance_hessian_is_of_rank_one_in_the_heading(lane_change, plain, along):
    p = programme(MpcConfig(horizon=2, v_goal_weight=0, y_goal_weight=0, lane_weight=0), lane_change.scene)
    p = p._replace(reach_x=p.reach_x[:1], reach_y=p.reach_y[:1])
    path = plain.values.new_path(2, 1)
    path.states[0] = [30.0, 1.5, 20.0, 0.2]
    plain.newton.simulate(p, path)
    other_x, other_y = (40.0, 1.7) if along else (31.0, 5.0)
    others = plain.values.Others(np.full((1, 3), other_x), np.full((1, 3), other_y))
    assert plain.cost.path_cost(p, path, others) > 1.0
    model = plain.cost.stage_model(p, path, 0, 0.0, others)
    place = "x" if along else "y"
    assert model.hh > 1.0
    assert getattr(model, place + "h") ** 2 == pytest.approx(model.hh * getattr(model, 2 * place))
    assert model.vh**2 == pytest.approx(model.hh * (model.vv))
    assert model.h / model.v == pytest.approx(model.hh / model.vh)


def test_lane_terms_are_those_of_the_reference(plain):
    def by_hand(y, centres):
        return 1.0 / np.sum(1.0 / (y - centres) ** 2)

    for centres in (np.array([1.75]), np.array([1.75, 5.25]), np.array([-1.75, 1.75, 5.25])):
        for y in (-3.0, 0.3, 2.0, 3.5, 5.0):
            value, slope, curve = plain.cost.lane_terms(y, centres)
            difference = (by_hand(y + 1e-6, centres) - by_hand(y - 1e-6, centres)) / 2e-6
            assert value == pytest.approx(by_hand(y, centres))
            assert slope == pytest.approx(difference, abs=1e-8)
            assert curve == pytest.approx(slope**2 / (2 * value))
        assert plain.cost.lane_terms(1.75, centres) == (0.0, 0.0, 2.0)


def test_sweep_solves_the_dense_newton_system(lane_change, plain, config, drawn):
    """Against gradient and Gauss-Newton Hessian in the inputs alone, assembled from differences of drives."""
    p, path, others = drawn
    steps, mu, damping = config.horizon, 0.5, 7.0
    work, bounds = plain.values.new_workspace(steps), every_bound(plain, config)
    plain.newton._start_multipliers(p, path, work, bounds, mu)
    slope = plain.sweep.sweep(p, path, work, others, bounds, mu, damping)
    plain.newton._direction(p, path, work, bounds)

    def merit(inputs):
        there = copy(plain, path)
        there.inputs[:] = inputs.reshape(steps, 2)
        plain.newton.simulate(p, there)
        return plain.cost.path_cost(p, there, others) + plain.cost.barrier(p, there, bounds, mu)

    flat, small = path.inputs.ravel(), 1e-6
    axes = small * np.eye(2 * steps)
    gradient = np.array([merit(flat + axis) - merit(flat - axis) for axis in axes]) / (2 * small)
    move = work.move[:, :2].ravel()
    assert slope < 0.0
    assert slope == pytest.approx(gradient @ move, rel=1e-5)
    hessian = dense_hessian(plain, p, path, others, work, mu, damping)
    np.testing.assert_allclose(move, np.linalg.solve(hessian, -gradient), rtol=1e-4, atol=1e-6)
    lateral = lambda inputs: inputs[:, 1] * states_of(plain, p, path, inputs)[:-1, 2]  # noqa: E731
    ahead, behind = (lateral(path.inputs + sign * small * work.move[:, :2]) for sign in (1, -1))
    np.testing.assert_allclose(work.move[:, 2], (ahead - behind) / (2 * small), atol=1e-6)


def dense_hessian(plain, p, path, others, work, mu, damping):
    steps, small = len(path.inputs), 1e-6

    def states(inputs):
        return states_of(plain, p, path, inputs)

    flat = path.inputs.ravel()
    axes = small * np.eye(2 * steps)
    jacobian = np.stack([(states(flat + axis) - states(flat - axis)) / (2 * small) for axis in axes], axis=-1)
    hessian = np.zeros((2 * steps, 2 * steps))
    for k in range(steps + 1):
        a = path.inputs[k, 0] if k < steps else 0.0
        model = plain.cost.stage_model(p, path, k, a, others)
        matrix = np.zeros((5, 5))
        for name in ("xx", "xv", "xh", "xa", "yy", "yv", "yh", "ya", "vv", "vh", "va", "hh", "ha", "aa"):
            i, j = ("xyvha".index(letter) for letter in name)
            matrix[i, j] = matrix[j, i] = getattr(model, name)
        rows = np.vstack([jacobian[k], np.eye(2 * steps)[2 * k] if k < steps else np.zeros(2 * steps)])
        if k > 0:
            for j in range(3):
                matrix[j + 1, j + 1] += plain.sweep._soft_bound(p, path, work, k - 1, j, mu)[1]
        hessian += rows.T @ matrix @ rows
        if k < steps and np.isfinite(p.lateral_max):
            speed, w = path.states[k, 2], path.inputs[k, 1]
            toward = w * jacobian[k, 2] + speed * np.eye(2 * steps)[2 * k + 1]
            low, high = p.lateral_max + speed * w, p.lateral_max - speed * w
            hessian += (work.box[k, 4] / low + work.box[k, 5] / high) * np.outer(toward, toward)
    return hessian + turn_rate_hessian(p, steps) + box_hessian(p, path, work, damping)


def states_of(plain, p, path, inputs):
    there = copy(plain, path)
    there.inputs[:] = inputs.reshape(-1, 2)
    plain.newton.simulate(p, there)
    return there.states.copy()


def turn_rate_hessian(p, steps):
    hessian = np.zeros((2 * steps, 2 * steps))
    for k in range(steps):
        hessian[2 * k + 1, 2 * k + 1] += 2 * p.turn_rate_weight
        if k > 0:
            change = np.zeros(2 * steps)
            change[2 * k + 1], change[2 * k - 1] = 1.0, -1.0
            hessian += 2 * p.turn_rate_change_weight * np.outer(change, change)
    hessian[-1, -1] += 2 * p.final_turn_rate
    return hessian


def box_hessian(p, path, work, damping):
    limits = np.array([p.acceleration_max, p.turn_rate_max])
    low, high = path.inputs + limits, limits - path.inputs
    return np.diag((work.box[:, :4:2] / low + work.box[:, 1:4:2] / high + damping / limits**2).ravel())
