"""Calibration of errors: by likelihood, and among laws that are as likely by their tails."""

from dataclasses import replace

import numpy as np
import pytest

from avrare_gp_pem.runtime.features import Box
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.variant import Variant

pytest.importorskip("scipy")
ROWS = 4000


class Nothing:
    """Latents that know nothing."""

    def predict(self, x):
        return np.zeros((len(x), 5)), np.zeros((len(x), 5))


def variant():
    return Variant(
        latents=Nothing(),
        inputs=("range",),
        input_mean=np.zeros(1),
        input_sd=np.ones(1),
        base_scale=np.array([[0.2, 0.0], [0.1, 0.0]]),
        dof=np.full(2, 3.0),
        limit=np.array(8.0),
        link="logit",
        frame="vehicle",
    )


def unseen(errors, detected=None):
    from avrare_gp_pem.training.calibration import UnseenRows

    latents = np.zeros((len(errors), 5))
    seen = np.ones(len(errors), bool) if detected is None else detected
    return UnseenRows(
        latents, latents, np.full(len(errors), 20.0), seen, np.where(seen[:, None], errors, np.nan)
    )


def shares(calibrated, errors):
    """Seen and own shares beyond 4 scales and 4 standard deviations, of both errors."""
    from avrare_gp_pem.training.scores import error_fits

    one = np.full((len(errors),), 1.0)
    law = calibrated.law(Box(0 * one, 20 * one, 1.5 * one, 4.5 * one, 1.8 * one, 1.7 * one, 4 * one), 0.0)
    assert isinstance(law, ObservationLaw)
    fits = error_fits(law, np.ones(len(errors), bool), errors)
    return [(fit.beyond(4.0), fit.beyond_sd(4.0)) for fit in fits]


def test_a_true_student_law_is_found_with_its_scale_and_detection():
    from avrare_gp_pem.training.calibration import calibrate

    rng = np.random.default_rng(0)
    errors = rng.standard_t([2.5, 4.0], (ROWS, 2)) * [0.3, 0.08]
    detected = rng.uniform(size=ROWS) < 0.7
    found = calibrate(variant(), unseen(errors, detected))
    np.testing.assert_allclose(found.dof, [2.5, 4.0], rtol=0.3)
    np.testing.assert_allclose(found.stretch, [1.5, 0.8], rtol=0.05)
    assert found.line[1] == pytest.approx(np.log(0.7 / 0.3), abs=0.1)


def test_among_equally_likely_laws_the_observed_tails_decide():
    from avrare_gp_pem.training.calibration import _degrees, _error_loss, calibrate

    # Nine rows of ten have light tails and the tenth very heavy ones: no Student-t law is right.
    rng = np.random.default_rng(1)
    heavy = rng.uniform(size=(ROWS, 1)) < 0.1
    light = rng.standard_t(6, (ROWS, 2))
    errors = np.clip(np.where(heavy, 2 * rng.standard_t(1.5, (ROWS, 2)), light) * [0.2, 0.1], -7, 7)
    rows = unseen(errors)
    found = calibrate(variant(), rows)
    for pairs in shares(found, errors):
        for seen, own in pairs:
            assert abs(np.log(seen / own)) < np.log(1.5)
    for axis in (0, 1):  # and it gives away no more than it may
        around = np.log(found.stretch[axis]) + np.linspace(-0.1, 0.1, 5)
        grid = np.log(found.dof[axis] - 1.05) + np.linspace(-0.6, 0.6, 7)
        best = min(_error_loss(variant(), rows, axis, s, f) for f in grid for s in around)
        freedom = np.log(found.dof[axis] - 1.05)
        assert _degrees(freedom) == pytest.approx(found.dof[axis])
        assert _error_loss(variant(), rows, axis, np.log(found.stretch[axis]), freedom) < best + 0.0025


def test_errors_that_are_all_zero_are_accepted():
    from avrare_gp_pem.training.calibration import calibrate

    found = calibrate(variant(), unseen(np.zeros((500, 2))))
    assert np.isfinite(found.dof).all()
    assert (found.stretch > 0).all()


def test_calibration_reads_no_errors_of_the_missed():
    from avrare_gp_pem.training.calibration import calibrate

    rng = np.random.default_rng(2)
    errors, detected = rng.standard_t(3, (2000, 2)), rng.uniform(size=2000) < 0.5
    rows = unseen(errors, detected)
    other = replace(rows, errors=np.where(detected[:, None], errors, 1e3))
    first, second = calibrate(variant(), rows), calibrate(variant(), other)
    np.testing.assert_array_equal(first.stretch, second.stretch)
    np.testing.assert_array_equal(first.dof, second.dof)
