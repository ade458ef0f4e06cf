"""Derivatives and the Riccati recursion, against differences and dense linear algebra; not compiled."""

import casadi as ca
import numpy as np
import pytest

from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import to_variables
from avrare_mpc.riccati.lanes import WIDTH, splat
from avrare_mpc.riccati.solver import programme

VARIANTS = {
    "reference": {},
    "lead": {"lateral_lead": "speed", "heading_weight": 3.0},
    "three lanes": {"lanes": [0, 1, 2], "turn_rate_change_weight": 2000.0},
    "lateral": {"lateral_acceleration_max": 20.0},
    "smooth start": {"smooth_start": True, "turn_rate_change_weight": 2000.0},
    "one lane": {"lanes": [1], "sharpness": 3.0, "turn_rate_weight": 0.0, "turn_rate_change_weight": 0.0},
}
LAST_TURN_RATE = 0.07


@pytest.fixture(params=list(VARIANTS))
def config(request):
    return MpcConfig.model_validate({"horizon": 8, **VARIANTS[request.param]})


@pytest.fixture
def drawn(config, lane_change, plain):
    """Return a programme and a random path in the thick of it, with its barrier at 0.5; all lanes alike."""
    rng, p = np.random.default_rng(4), programme(config, lane_change.scene)
    _, path, _, work = plain.values.new_memory(config.horizon, 3)
    put(path.states[:4], [30.0, 3.3, 21.0, 0.1])
    put(path.inputs, [2.0, 0.2] * rng.standard_normal((config.horizon, 2)))
    work.status[plain.values.LAST] = LAST_TURN_RATE
    shape = (config.horizon + 1, 3)
    put(work.others, np.stack([rng.uniform(28, 55, shape), rng.uniform(-1, 6, shape)], axis=-1))
    simulate(plain, p, path, work)
    plain.cost.path_cost(p, path, work)
    plain.cost.barrier(p, path, every_bound(plain, config), splat(0.5))
    return p, path, work


def put(memory, values):
    memory[:] = np.reshape(values, (-1, 1))


def get(memory, columns):
    return memory[:, 0].reshape(-1, columns).copy()


def simulate(plain, p, path, work):
    """Fill in the states of the path from its first one and its inputs."""
    fresh = np.full(WIDTH, True)
    plain.newton.follow(p, path, path, work, plain.values.Bounds(2, 1), splat(0.0), fresh)


def every_bound(plain, config):
    return plain.values.Bounds(hard=2 if config.lateral_acceleration_max is None else 3, soft=3)


def copy(plain, path):
    return plain.values.Path(*(part.copy() for part in path))


def test_cost_and_model_are_those_of_the_programme(config, lane_change, plain, drawn):
    p, path, work = drawn
    nlp = build_problem(config, lane_change.scene)
    cost = ca.Function("cost", [nlp.variables, nlp.parameters], [nlp.cost])
    states, inputs = get(path.states, 4), get(path.inputs, 2)
    x, y = get(work.others, 6).reshape(-1, 3, 2).T  # (3, H + 1) each
    start, variables = np.append(states[0], LAST_TURN_RATE), to_variables(states, inputs)
    variables[4] = LAST_TURN_RATE
    parameters = pack_parameters(lane_change.scene, start[None], x[None], y[None])[0]
    expected = float(cost(variables, parameters))
    assert plain.cost.path_cost(p, path, work)[0] == pytest.approx(expected, rel=1e-12)
    dynamics = ca.Function("gaps", [nlp.variables, nlp.parameters], [nlp.constraints])
    gaps = np.asarray(dynamics(variables, parameters)).ravel()
    assert np.abs(gaps[nlp.lower == nlp.upper]).max() < 1e-12


def test_slacks_are_the_least(plain):
    gaps = np.array([-2.0, -1e-9, 0.0, 1e-9, 3.0, 1e-3, -1e-3, 40.0])
    penalty, mu = 1e5, 1e-3
    *small, sums = plain.cost.slacks(gaps, gaps[::-1].copy(), splat(mu / penalty))
    product = 1.0
    for gap, least in zip((gaps, gaps[::-1]), small, strict=True):
        inside, outside = plain.cost.inside(gap, least), plain.cost.outside(gap, least)
        np.testing.assert_allclose(inside - outside, gap, atol=1e-12)
        np.testing.assert_allclose(mu / inside + mu / outside, penalty, rtol=1e-9)
        product = product * inside * outside * penalty / mu
    np.testing.assert_allclose(sums, product, rtol=1e-9)


def moved(plain, p, path, work, centre):
    """Copy the path with node 0 at ``centre`` (x, y, v, h, a); return the copy and its cost."""
    there = copy(plain, path)
    put(there.states[:4], centre[:4])
    there.inputs[0] = centre[4]
    put(there.turn[:2], [np.cos(centre[3]), np.sin(centre[3])])
    return there, plain.cost.path_cost(p, there, work)[0]


def centre_of(path):
    return np.array([*get(path.states, 4)[0], path.inputs[0, 0]])


def test_stage_gradient_is_that_of_the_cost(plain, drawn):
    p, path, work = drawn
    centre, step = centre_of(path), 1e-5
    model = plain.cost.stage_model(p, path, 0, splat(centre[4]))
    for name, axis in zip("xyvha", np.eye(5), strict=True):
        ahead, behind = (moved(plain, p, path, work, centre + sign * step * axis)[1] for sign in (1, -1))
        assert getattr(model, f"grad_{name}")[0] == pytest.approx(
            (ahead - behind) / (2 * step), rel=1e-6, abs=1e-4
        )


def test_stage_hessian_is_exact_where_the_clearances_are_linear(plain, drawn):
    """Compare at a fixed heading; the lanes are left out, their curvature is Gauss-Newton's."""
    p, path, work = drawn
    p, step = p._replace(lane_weight=0.0), 1e-6
    centre = centre_of(path)
    model = plain.cost.stage_model(p, path, 0, splat(centre[4]))
    for name in ("xx", "xv", "xa", "yy", "yv", "ya", "vv", "va", "aa"):
        axis, slopes = np.eye(5)["xyvha".index(name[1])], []
        for sign in (1.0, -1.0):
            there, _ = moved(plain, p, path, work, centre + sign * step * axis)
            shifted = plain.cost.stage_model(p, there, 0, there.inputs[0])
            slopes.append(getattr(shifted, f"grad_{name[0]}")[0])
        expected = (slopes[0] - slopes[1]) / (2 * step)
        assert getattr(model, name)[0] == pytest.approx(expected, rel=1e-5, abs=1e-3)


def test_sweep_solves_the_dense_newton_system(lane_change, plain, config, drawn):
    """Solve for the inputs alone: gradient and Gauss-Newton Hessian from differences of drives."""
    p, path, work = drawn
    steps, mu, damping, bounds = config.horizon, 0.5, 7.0, every_bound(plain, config)
    plain.newton._prepare(p, path, work, bounds, splat(mu), np.full(WIDTH, True))
    slope = plain.sweep.sweep(p, path, work, bounds, splat(mu), splat(damping))[0]
    plain.newton._direction(p, path, work, bounds)
    inputs = get(path.inputs, 2)

    def merit(flat):
        there = driven(plain, p, path, work, flat)
        cost = plain.cost.path_cost(p, there, work)
        return (cost + plain.cost.barrier(p, there, bounds, splat(mu)))[0]

    flat, small = inputs.ravel(), 1e-6
    axes = small * np.eye(2 * steps)
    gradient = np.array([merit(flat + axis) - merit(flat - axis) for axis in axes]) / (2 * small)
    moves = get(work.move, 3)
    move = moves[:, :2].ravel()
    assert slope < 0.0
    assert slope == pytest.approx(gradient @ move, rel=1e-5)
    hessian = dense_hessian(plain, p, path, work, damping)
    np.testing.assert_allclose(move, np.linalg.solve(hessian, -gradient), rtol=1e-4, atol=1e-6)
    if bounds.hard > 2:
        there = [driven(plain, p, path, work, flat + sign * small * move) for sign in (1, -1)]
        ahead, behind = (get(one.inputs, 2)[:, 1] * get(one.states, 4)[:-1, 2] for one in there)
        np.testing.assert_allclose(moves[:, 2], (ahead - behind) / (2 * small), atol=1e-6)


def driven(plain, p, path, work, flat):
    """Return the path with other inputs."""
    there = copy(plain, path)
    put(there.inputs, flat)
    simulate(plain, p, there, work)
    return there


def dense_hessian(plain, p, path, work, damping):
    steps, small = p.steps, 1e-6

    def states(flat):
        return get(driven(plain, p, path, work, flat).states, 4)

    inputs, here = get(path.inputs, 2), get(path.states, 4)
    flat = inputs.ravel()
    axes = small * np.eye(2 * steps)
    jacobian = np.stack([(states(flat + axis) - states(flat - axis)) / (2 * small) for axis in axes], axis=-1)
    box, hessian = get(work.box, 6), np.zeros((2 * steps, 2 * steps))
    for k in range(steps + 1):
        model = plain.cost.stage_model(p, path, k, splat(inputs[k, 0] if k < steps else 0.0))
        matrix = np.zeros((5, 5))
        for name in ("xx", "xv", "xh", "xa", "yy", "yv", "yh", "ya", "vv", "vh", "va", "hh", "ha", "aa"):
            i, j = ("xyvha".index(letter) for letter in name)
            matrix[i, j] = matrix[j, i] = getattr(model, name)[0]
        rows = np.vstack([jacobian[k], np.eye(2 * steps)[2 * k] if k < steps else np.zeros(2 * steps)])
        if k > 0:
            stiffness = get(work.stiffness, 2).reshape(-1, 3, 2)[k - 1].sum(axis=1)
            matrix[[1, 2, 3], [1, 2, 3]] += stiffness
        hessian += rows.T @ matrix @ rows
        if k < steps and np.isfinite(p.lateral_max):
            speed, w = here[k, 2], inputs[k, 1]
            toward = w * jacobian[k, 2] + speed * np.eye(2 * steps)[2 * k + 1]
            low, high = p.lateral_max + speed * w, p.lateral_max - speed * w
            hessian += (box[k, 4] / low + box[k, 5] / high) * np.outer(toward, toward)
    return hessian + turn_rate_hessian(p, steps) + box_hessian(p, inputs, box, damping)


def turn_rate_hessian(p, steps):
    hessian = np.zeros((2 * steps, 2 * steps))
    for k in range(steps):
        hessian[2 * k + 1, 2 * k + 1] += 2 * p.turn_rate_weight
        if k > 0:
            change = np.zeros(2 * steps)
            change[2 * k + 1], change[2 * k - 1] = 1.0, -1.0
            hessian += 2 * p.turn_rate_change_weight * np.outer(change, change)
    hessian[1, 1] += 2 * p.start_change_weight
    hessian[-1, -1] += 2 * p.final_turn_rate
    return hessian


def box_hessian(p, inputs, box, damping):
    limits = np.array([p.acceleration_max, p.turn_rate_max])
    low, high = inputs + limits, limits - inputs
    return np.diag((box[:, :4:2] / low + box[:, 1:4:2] / high + damping / limits**2).ravel())
