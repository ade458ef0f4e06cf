"""Calibration of errors: by likelihood, and among laws that are as likely by their tails."""

from dataclasses import replace

import numpy as np
import pytest

from avrare_gp_pem.runtime.features import Box
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.student_t import student
from avrare_gp_pem.runtime.variant import Variant
from avrare_pem_training.calibration import UnseenRows, _ErrorsUnderLaws, _fit_error, calibrate
from avrare_pem_training.scores import fit_errors

ROWS = 3000


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
    latents = np.zeros((len(errors), 5))
    seen = np.ones(len(errors), bool) if detected is None else detected
    errors = np.where(seen[:, None], errors, np.nan)
    return UnseenRows(latents, latents, np.full(len(errors), 20.0), seen, errors)


def shares(calibrated, errors):
    """Return seen and own shares beyond 4 scales and 4 standard deviations, of both errors."""
    one = np.full((len(errors),), 1.0)
    law = calibrated.law(Box(0 * one, 20 * one, 1.5 * one, 4.5 * one, 1.8 * one, 1.7 * one, 4 * one), 0.0)
    assert isinstance(law, ObservationLaw)
    fits = fit_errors(law, np.ones(len(errors), bool), errors)
    return [(fit.beyond(4.0), fit.beyond_sd(4.0)) for fit in fits]


def test_a_true_student_law_is_found_with_its_scale_and_detection():
    rng = np.random.default_rng(0)
    errors = rng.standard_t([2.5, 4.0], (ROWS, 2)) * [0.3, 0.08]
    detected = rng.uniform(size=ROWS) < 0.7
    found = calibrate(variant(), unseen(errors, detected))
    np.testing.assert_allclose(found.dof, [2.5, 4.0], rtol=0.3)
    np.testing.assert_allclose(found.stretch, [1.5, 0.8], rtol=0.05)
    assert found.line[1] == pytest.approx(np.log(0.7 / 0.3), abs=0.1)


def test_far_tails_are_found_that_no_student_law_has():
    rng = np.random.default_rng(1)  # like a Student-t with 2 degrees of freedom, then ever less
    errors = np.sinh(0.5 * np.arcsinh(rng.standard_t(2, (ROWS, 2)))) / 0.5 * [0.2, 0.1]
    rows = unseen(errors)
    found = calibrate(variant(), rows)
    for pairs in shares(found, errors):
        for seen, own in pairs:
            assert seen == pytest.approx(own, abs=0.004)
    assert (found.tail[:, 0] < -0.2).all()
    plain = _fit_error(_ErrorsUnderLaws(variant(), rows, 0), 0)
    given, trial = _ErrorsUnderLaws(variant(), rows, 0), np.log(found.dof[0] - 1.05)
    chosen = np.array([np.log(found.stretch[0]), trial, *found.tail[0]])
    assert (given.losses(chosen) < given.losses(plain)).all()


def nearby(power):
    """Return errors at 2 to 60 m, Student-t farther than 20 m and with tails to a power at range 0."""
    rng = np.random.default_rng(4)
    distance = rng.uniform(2, 60, 3 * ROWS)
    powers = np.exp(np.log(power) * np.maximum(0.0, 1 - distance / 20))[:, None]
    t = rng.standard_t(2.2, (len(distance), 2))
    return distance, np.sinh(powers * np.arcsinh(t)) / powers * [0.2, 0.1]


def test_lighter_tails_nearby_are_found():
    distance, errors = nearby(0.3)
    found = calibrate(variant(), replace(unseen(errors), distance=distance))
    near, far = np.exp(found.tail.sum(axis=1)), np.exp(found.tail[:, 0])
    assert (near < 0.75 * far).all()
    one = np.ones((1, 2))
    box = Box(0 * one, np.array([[5.0, 40.0]]), *(size * one for size in (1.5, 4.5, 1.8, 1.7, 4)))
    law = found.law(box, 0.0)
    tail = 2 * student(law.dof[0]).upper_tail(1.6 / law.scale[0, :, 0], law.power[0, :, 0])
    seen = [(np.abs(errors[where, 0]) > 1.6).mean() for where in (distance < 8, distance > 20)]
    assert tail[0] < 0.01
    assert tail[1] == pytest.approx(seen[1], rel=0.3)
    assert seen[0] < 0.01


def test_misses_nearby_have_an_offset_that_few_rows_do_not_move():
    rng = np.random.default_rng(5)
    distance = rng.uniform(0, 60, ROWS)
    detected = (rng.uniform(size=ROWS) < 0.9) | (distance < 20)
    errors = rng.standard_t(3, (ROWS, 2))
    for rows, low, high in ((slice(None), 3.0, 9.0), (slice(0, 30), -1.0, 2.5)):
        some = replace(unseen(errors, detected).take(np.arange(ROWS)[rows]), distance=distance[rows])
        assert low < calibrate(variant(), some).near < high


def test_calibration_reads_no_errors_of_the_missed():
    rng = np.random.default_rng(2)
    errors, detected = rng.standard_t(3, (2000, 2)), rng.uniform(size=2000) < 0.5
    rows = unseen(errors, detected)
    other = replace(rows, errors=np.where(detected[:, None], errors, 1e3))
    first, second = calibrate(variant(), rows), calibrate(variant(), other)
    np.testing.assert_array_equal(first.stretch, second.stretch)
    np.testing.assert_array_equal(first.dof, second.dof)
