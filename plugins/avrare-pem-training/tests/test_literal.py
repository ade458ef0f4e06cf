"""The perception model of the STL-AMS paper to the letter, and normal errors."""

import math

import numpy as np
import pytest
from scipy import stats

from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.runtime.features import LITERAL
from avrare_gp_pem.runtime.models import build_gp
from avrare_gp_pem.runtime.store import load, locate, save
from avrare_gp_pem.runtime.student_t import student
from avrare_pem_training.cleaning import clean
from avrare_pem_training.scores import evaluate
from avrare_pem_training.table import make_table

Z = np.linspace(-6, 6, 41)


@pytest.mark.parametrize("power", [None, 0.5, 1.7])
def test_normal_errors_have_the_normal_law(power):
    law, k = student(math.inf), 1.0 if power is None else power
    drawn = law.draw_truncated(Z, np.full_like(Z, np.inf), k)
    z = np.sinh(np.arcsinh(k * drawn) / k)
    np.testing.assert_allclose(z, Z, atol=1e-12)
    np.testing.assert_allclose(law.upper_tail(np.abs(drawn), k), stats.norm.sf(np.abs(Z)), rtol=1e-10)
    slope = np.cosh(k * np.arcsinh(Z)) / np.cosh(np.arcsinh(Z))  # of the value in z
    powers = None if power is None else np.full_like(Z, k)
    density = law.truncated_log_density(drawn, np.full_like(Z, np.inf), powers)
    np.testing.assert_allclose(density, stats.norm.logpdf(Z) - np.log(slope), atol=1e-10)


def test_the_shipped_model_is_the_papers():
    model = load(locate("literal"))
    assert model.delivered is not None
    for variant in (model.clean, model.delivered):
        names = ("right", "forward", "yaw", "length", "width", "height", "visibility")
        assert variant.inputs == LITERAL == names
        assert np.isinf(variant.dof).all()
        assert len(variant.latents.detection.inducing) == len(variant.latents.error.inducing) == 100
        assert variant.latents.error.factor.ndim == 3
        np.testing.assert_array_equal(variant.line, [1.0, 0.0])  # nothing is calibrated


def test_its_density_is_that_of_its_draws(make):
    # one vehicle: of all draws, the mean of 1 / density over a box of errors is the box's area
    pem = build_gp(GpPemConfig(model="literal", speed_sd=0.0), make.scene(1))
    world = make.world([[20.0, 2.0, 0.1]], n=20_000)
    noise = np.random.default_rng(0).standard_normal((20_000, 4))
    noise[:, 0] = -8.0
    noise[:, 3] = 0.0
    seen = pem.observe(world, noise)
    dx, dy = 20.0 - seen.x[:, 0], 2.0 - seen.y[:, 0]
    inside = (np.abs(dx) < 0.5) & (np.abs(dy) < 0.5)
    detect = pem.law(world).detect[0, 0]
    weights = np.where(inside, np.exp(-pem.log_prob(world, seen)), 0.0) * detect
    assert weights.mean() == pytest.approx(1.0, abs=4 * weights.std() / math.sqrt(len(weights)))


@pytest.mark.slow
def test_a_fit_finds_normal_errors(drive, tmp_path):
    from avrare_pem_training.fit_gp import Schedule
    from avrare_pem_training.pipeline import FitPlan, fit_model

    rows = vars(drive(1500)).copy()
    errors = np.random.default_rng(1).normal(0, [[0.4], [0.2]], (2, 1500))
    rows |= {"error_right": 0.3 + errors[0], "error_forward": errors[1]}
    data = clean(make_table({name: np.asarray(part, float) for name, part in rows.items()}), artefact=False)
    plan = FitPlan("literal", schedule=Schedule(inducing=12, steps=150, batch=128, checks=1, weight=1.0))
    model = fit_model(data, plan, {"licence": "none"}, lambda line: None).model
    save(tmp_path / "a.npz", model)
    again = load(tmp_path / "a.npz")
    law = again.clean.law(data.test, 0.0)
    seen = data.test.detected
    np.testing.assert_allclose(law.scale.mean(axis=0), [0.4, 0.2], rtol=0.15)
    assert law.location[seen, 0].mean() == pytest.approx(0.3, abs=0.08)
    scores = evaluate(again, data)["delivered"].scores
    assert scores["detection_nll"] < scores["detection_base_nll"]
    assert scores["right_nll"] == pytest.approx(0.5 + math.log(0.4 * math.sqrt(2 * math.pi)), abs=0.15)
