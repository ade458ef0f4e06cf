"""The distribution functions, drawing and scoring of observations."""

import math

import numpy as np
import pytest
from scipy import stats

from avrare_gp_pem.runtime import normal
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.student_t import student

POINTS = np.array([-8.0, -6.0, -5.0, -1.0, -0.5, 0.0, 0.3, 0.7, 2.0, 5.6, 5.7, 8.0])


def test_normal_cdf_is_that_of_the_standard_library():
    exact = np.array([0.5 * math.erfc(-z / math.sqrt(2)) for z in POINTS])
    np.testing.assert_allclose(normal.cdf(POINTS), exact, rtol=1e-14)
    np.testing.assert_array_equal(normal.cdf(np.array([-np.inf, np.inf])), [0.0, 1.0])


@pytest.mark.parametrize("dof", [1.5, 2.2, 2.4, 5.0, 30.0])
def test_student_against_scipy(dof):
    t = np.geomspace(1e-3, 1000, 400)
    np.testing.assert_allclose(student(dof).upper_tail(t), stats.t.sf(t, dof), rtol=1e-5 if dof > 5 else 1e-8)
    np.testing.assert_allclose(student(dof).log_density(t), stats.t.logpdf(t, dof), rtol=1e-10)
    noise = np.linspace(-6, 6, 401)
    beyond = stats.t.sf(40.0, dof)
    exact = np.sign(noise) * stats.t.isf(beyond + stats.norm.sf(np.abs(noise)) * (1 - 2 * beyond), dof)
    drawn = student(dof).draw_truncated(noise, np.full_like(noise, 40.0))
    np.testing.assert_allclose(drawn, exact, rtol=1e-6, atol=1e-9)
    assert (np.diff(drawn) > 0).all()


def test_truncated_density_integrates_to_one_and_ends():
    t = np.linspace(-3.0, 3.0, 200001)
    density = np.exp(student(2.3).truncated_log_density(t, np.full_like(t, 3.0)))
    assert np.trapezoid(density, t) == pytest.approx(1.0, abs=1e-8)
    assert student(2.3).truncated_log_density(np.array(3.001), np.array(3.0)) == -np.inf


@pytest.mark.parametrize("power", [0.6, 1.0, 1.4])
def test_powers_of_tails(power):
    table, bound = student(3.0), 30.0
    t = np.linspace(-bound, bound, 400_001)
    density = np.exp(table.truncated_log_density(t, np.full_like(t, bound), np.full_like(t, power)))
    assert np.trapezoid(density, t) == pytest.approx(1.0, abs=1e-6)
    size = np.geomspace(0.01, 20, 50)
    exact = stats.t.sf(np.sinh(np.arcsinh(power * size) / power), 3.0)
    np.testing.assert_allclose(table.upper_tail(size, power), exact, rtol=1e-7)
    noise = np.linspace(-5, 5, 201)
    drawn = table.draw_truncated(noise, np.full_like(noise, bound), np.full_like(noise, power))
    assert (np.diff(drawn) > 0).all()
    below = np.interp(drawn, t, np.append(0.0, np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(t))))
    np.testing.assert_allclose(below, [0.5 * math.erfc(-z / math.sqrt(2)) for z in noise], atol=1e-5)
    far = np.array([50.0, 100.0])
    index = -np.diff(np.log(table.upper_tail(far, power))) / np.diff(np.log(far))
    assert index == pytest.approx(3.0 / power, rel=0.03)


def law(detect=0.7, speed_sd=0.3, n=1):
    shape = (n, 1)
    return ObservationLaw(
        detect=np.full(shape, detect),
        miss=np.full(shape, 1 - detect),
        location=np.broadcast_to(np.array([0.1, -0.05]), (*shape, 2)),
        scale=np.broadcast_to(np.array([0.2, 0.1]), (*shape, 2)),
        dof=(2.4, 2.2),
        limit=6.0,
        speed_sd=speed_sd,
    )


def test_log_prob_integrates_to_one(make):
    # over a grid around a turned vehicle: seen on the grid plus missed is everything
    grid = np.linspace(-6.5, 6.5, 261)
    x, y = (part.ravel() for part in np.meshgrid(grid, grid))
    world = make.world([[20.0, 3.0, 0.4]], n=len(x))
    wide = law(n=len(x))
    wide = ObservationLaw(wide.detect, wide.miss, wide.location, wide.scale * 8, wide.dof, 4.0, 0.3)
    observation = wide.draw(world, np.zeros((len(x), 4)))
    at = type(observation)(
        detected=np.ones((len(x), 1), bool),
        x=world.others.x + x[:, None],
        y=world.others.y + y[:, None],
        speed_x=world.others.speed * np.cos(0.4),
    )
    cell = (grid[1] - grid[0]) ** 2 * 0.3 * math.sqrt(2 * math.pi)  # the speed integrates out of its peak
    assert np.exp(wide.log_prob(world, at)).sum() * cell == pytest.approx(0.7, rel=0.01)
    missed = type(observation)(~at.detected, at.x * np.nan, at.y * np.nan, at.speed_x * np.nan)
    np.testing.assert_allclose(np.exp(wide.log_prob(world, missed)), 0.3)


def test_log_prob_is_the_density_of_what_is_drawn(make):
    # change of variables, one number at a time: p(observation) |d observation / d noise| = p(noise)
    world, model, step = make.world([[20.0, 3.0, 0.4]]), law(), 1e-5
    noise = np.array([[-1.0, 0.8, -1.7, 0.4]])
    centre = model.draw(world, noise)
    columns = []
    for i in (1, 2, 3):
        bump = np.zeros((1, 4))
        bump[0, i] = step
        high, low = model.draw(world, noise + bump), model.draw(world, noise - bump)
        columns.append([(getattr(high, k) - getattr(low, k)).item() for k in ("x", "y", "speed_x")])
    jacobian = abs(np.linalg.det(np.array(columns) / (2 * step)))
    density = math.exp(-0.5 * (noise[0, 1:] ** 2).sum()) / (2 * math.pi) ** 1.5
    expected = math.log(0.7 * density / jacobian)
    assert model.log_prob(world, centre).item() == pytest.approx(expected, abs=1e-5)


def test_impossible_observations_have_no_probability(make):
    world = make.world([[20.0, 0.0, 0.0]])
    seen = law().draw(world, np.array([[-9.0, 0.0, 0.0, 0.0]]))
    assert law(detect=0.0).log_prob(world, seen) == -np.inf
    far = type(seen)(seen.detected, seen.x + 10, seen.y, seen.speed_x)
    assert law().log_prob(world, far) == -np.inf
    exact = law(speed_sd=0.0)
    assert np.isfinite(exact.log_prob(world, exact.draw(world, np.full((1, 4), -0.5))))
    assert exact.log_prob(world, law().draw(world, np.full((1, 4), -0.5))) == -np.inf
