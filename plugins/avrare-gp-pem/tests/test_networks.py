"""Networks at run time: what they compute, row by row, and their file."""

import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.runtime.features import AXES, COLUMNS, COMMON, Box, features
from avrare_gp_pem.runtime.models import build_gp
from avrare_gp_pem.runtime.networks import networks
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.store import FittedPem, load, save
from avrare_gp_pem.runtime.variant import MeasuredPersistence, Variant, YawErrors
from perception_scenes import change_file, check_rows

YAW = YawErrors(np.array([-3.0, 0.02]), np.array([0.01, 0.001]), np.array(2.0))
INPUTS = ("range", "cos_aspect", "sin_aspect", "length", "reach_50")


def random_networks(widths=(5, 24, 32, 5), members=3, seed=0):
    rng = np.random.default_rng(seed)
    weights = [rng.normal(0, 0.5, (members, *pair)) for pair in pairwise(widths)]
    biases = [rng.normal(0, 0.3, (members, width)) for width in widths[1:]]
    return tuple(
        tuple(part.astype(np.float32).astype(float) for part in parts) for parts in (weights, biases)
    )


def random_variant(frame="vehicle", seed=0):
    return Variant(
        latents=networks(*random_networks(seed=seed)),
        inputs=INPUTS,
        input_mean=np.array([30.0, 0, 0, 4.5, 0]),
        input_sd=np.array([20.0, 1, 1, 0.5, 1]),
        base_scale=np.array([[0.1, 0.01], [0.05, 0.005]]),
        dof=np.array([2.5, 3.0]),
        limit=np.array(8.0),
        link="logit",
        frame=frame,
        bounds=np.array([[0.0, -1, -1, 3, -1], [80.0, 1, 1, 6, 1]]),
        line=np.array([0.9, 0.1]),
        stretch=np.array([1.1, 0.9]),
    )


def by_hand(weights, biases, x):
    outputs = []
    for k in range(len(weights[0])):
        hidden = x
        for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            hidden = np.einsum("nd,dh->nh", np.maximum(hidden, 0) if i else hidden, weight[k]) + bias[k]
        outputs.append(hidden)
    return np.mean(outputs, axis=0)


@pytest.mark.parametrize("widths", [(5, 5), (5, 7, 5), (5, 24, 32, 5), (3, 16, 16, 16, 2)])
def test_the_mean_of_the_networks(widths):
    weights, biases = random_networks(widths)
    x = np.random.default_rng(1).normal(size=(101, widths[0]))
    mean, variance = networks(weights, biases).predict(x)
    np.testing.assert_allclose(mean, by_hand(weights, biases, x), atol=2e-5)
    assert mean.dtype == np.float64
    np.testing.assert_array_equal(variance, np.zeros_like(mean))


@pytest.mark.parametrize("widths", [(29, 32, 32, 5), (35, 32, 32, 5), (7, 5)])
def test_rows_are_the_same_in_any_batch_and_place(widths):
    check_rows(networks(*random_networks(widths, members=5)).predict, widths[0])


def test_layers_that_do_not_fit_are_refused():
    weights, biases = random_networks()
    with pytest.raises(ValueError, match="do not match"):
        networks((weights[0], weights[2]), (biases[0], biases[2]))


def test_the_law_is_its_formula(make):
    variant, one = random_variant(), np.array([[1.0]])
    box = Box(3 * one, 40 * one, 1.2 * one, 4.5 * one, 1.8 * one, 1.7 * one, 4 * one)
    x = (features(box, INPUTS)[0] - variant.input_mean) / variant.input_sd
    latent = variant.latents.predict(x)[0][0]
    law = variant.law(box, 0.3)
    assert law.detect.item() == pytest.approx(1 / (1 + np.exp(-(0.9 * latent[0] + 0.1))), rel=1e-12)
    assert law.detect.item() + law.miss.item() == pytest.approx(1.0, abs=1e-15)
    base = np.array([0.1, 0.05]) + np.array([0.01, 0.005]) * np.hypot(3, 40)
    np.testing.assert_allclose(law.location[0, 0], base * latent[1:3])
    np.testing.assert_allclose(law.scale[0, 0], base * np.exp(latent[3:]) * [1.1, 0.9])


def test_nearby_vehicles_have_a_calibration_of_their_own():
    tail = np.array([[0.2, -0.5], [0.0, 0.3]])
    variant, one = random_variant(), np.array([[1.0]])
    near = replace(variant, near=np.array(1.5), tail=tail)
    for distance, nearness in ((5.0, 0.75), (20.0, 0.0), (60.0, 0.0)):
        box = Box(0 * one, distance * one, 1.2 * one, 4.5 * one, 1.8 * one, 1.7 * one, 4 * one)
        plain, law = variant.law(box, 0.3), near.law(box, 0.3)
        logit = np.log(law.detect / law.miss) - np.log(plain.detect / plain.miss)
        assert logit == pytest.approx(1.5 * nearness, abs=1e-9)
        np.testing.assert_allclose(law.power[0, 0], np.exp(tail[:, 0] + tail[:, 1] * nearness))
        np.testing.assert_array_equal(law.scale, plain.scale)
    assert variant.law(box, 0.3).power is None


def test_columns_have_the_names_that_models_list():
    assert set(COMMON) | set(AXES) <= set(COLUMNS)
    one = np.array(1.0)
    box = Box(3 * one, -4 * one, 0.2 * one, 4.5 * one, 1.8 * one, 1.7 * one, 2 * one)
    bearing = np.arctan2(-4, 3)
    expected = {
        "log_range": np.log(5), "abs_forward": 4, "reach": 4, "reach_10": np.tanh(-2),
        "cos_2bearing": np.cos(2 * bearing), "sin_2aspect": np.sin(2 * (0.2 - bearing)),
        "log_span_right": np.log(4.5 * np.cos(0.2) + 0.02),
        "log_span_forward": np.log(1.8 * np.sin(0.2) + 0.02),
    }  # fmt: skip
    np.testing.assert_allclose(features(box, tuple(expected)), list(expected.values()))


def test_file_survives_a_round_trip(tmp_path, make):
    clean = replace(random_variant(), near=np.array(0.7), tail=np.array([[0.1, 0.2], [0.3, -0.4]]))
    lasting = MeasuredPersistence(np.array([0.4, 0.3]), np.array([0.6, 0.1]))
    model = FittedPem(clean, random_variant("ego", seed=4), {"licence": "none"}, YAW, lasting)
    save(tmp_path / "a.npz", model)
    again = load(tmp_path / "a.npz")
    save(tmp_path / "b.npz", again)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert again.provenance == {"licence": "none"}
    assert again.yaw.dof == 2.0
    np.testing.assert_array_equal(again.clean.tail, clean.tail)
    assert again.clean.near == 0.7
    np.testing.assert_array_equal(again.persistence.position, [0.6, 0.1])
    world = make.random(20, 3)
    noise = np.random.default_rng(0).normal(size=(20, 12))
    for artefact, variant in ((False, model.clean), (True, model.delivered)):
        config = GpPemConfig(model=str(tmp_path / "a.npz"), artefact=artefact)
        pem = build_gp(config, make.scene(3))
        assert pem.variant.frame == variant.frame
        law = pem.law(world)
        assert law.in_ego_frame == artefact
        seen = pem.observe(world, noise)
        assert np.isfinite(pem.log_prob(world, seen)).all()


@pytest.mark.parametrize("change", [{"clean_inputs": np.array(["range", "moon"])}, {"format": np.array(4)}])
def test_files_of_other_versions_are_refused(tmp_path, change):
    save(tmp_path / "a.npz", FittedPem(random_variant(), None, {}))
    change_file(tmp_path / "a.npz", **change)
    with pytest.raises(UsageError, match="this version"):
        load(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"clean_input_mean": np.zeros(4)},
        {"clean_line": np.zeros(3)},
        {"clean_inputs": np.array(["range", "length"])},
        {"clean_frame": np.array("[]")},
        {"yaw_flip": np.array(7.0)},
        {"yaw_scale": np.array([0.01, np.nan])},
        {"yaw_dof": np.array([1.0, 2.0])},
    ],
)
def test_files_whose_parts_do_not_fit_are_refused(tmp_path, change):
    save(tmp_path / "a.npz", FittedPem(random_variant(), None, {}, YAW))
    change_file(tmp_path / "a.npz", **change)
    with pytest.raises(UsageError, match="not a perception model"):
        load(tmp_path / "a.npz")


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.0])
def test_errors_in_the_frame_of_the_ego(make, angle):
    # ego turned by the angle, car anywhere: an error to the right lies to the ego's right
    world = make.turned(make.world([[20.0, 3.0, 1.1]]), angle)
    one, located = np.ones((1, 1)), np.array([[[0.5, 0.2]]])
    law = ObservationLaw(one, 0 * one, located, np.full((1, 1, 2), 1e-9), (3.0, 3.0), 6.0, 0.3, True)
    seen = law.draw(world, np.zeros((1, 4)))
    error = np.array([(world.others.x - seen.x)[0, 0], (world.others.y - seen.y)[0, 0]])
    right, forward = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose([error @ right, error @ forward], [0.5, 0.2], atol=1e-6)
    assert law.log_prob(world, seen) > law.log_prob(make.world([[20.1, 3.0, 1.1]]), seen)
    np.testing.assert_allclose(seen.speed_x, 10 * np.cos(1.1 + angle))


def test_yaw_law_integrates_to_one():
    law = YawErrors(np.array([-2.0, 0.02]), np.array([0.05, 0.002]), np.array(2.5))
    error = np.linspace(-np.pi, np.pi, 400001)
    density = np.exp(law.log_density(error, np.full_like(error, 30.0)))
    assert np.trapezoid(density, error) == pytest.approx(1.0, abs=1e-4)
    flips = np.trapezoid(np.where(np.abs(error) > np.pi / 2, density, 0.0), error)
    assert flips == pytest.approx(1 / (1 + np.exp(1.4)), abs=1e-4)


IN_A_PROCESS = """
import numpy as np
from avrare_gp_pem.runtime.networks import networks
rng = np.random.default_rng(0)
sizes = ((29, 32), (32, 32), (32, 5))
weights = tuple(rng.normal(0, 0.5, (5, *size)) for size in sizes)
model = networks(weights, tuple(rng.normal(0, 0.3, (5, width)) for _, width in sizes))
x = rng.normal(size=(50, 29))
whole = model.predict(x)[0]
assert all((model.predict(x[k:])[0] == whole[k:]).all() for k in range(50))
"""


@pytest.mark.parametrize("kernel", ["Haswell", "Nehalem"])
def test_rows_are_the_same_with_other_kernels_of_openblas(kernel):
    """The kernel for AVX2 sums the rows of its tiles in two orders; most machines have another one."""
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    subprocess.run([sys.executable, "-c", IN_A_PROCESS], env=environment, check=True)
