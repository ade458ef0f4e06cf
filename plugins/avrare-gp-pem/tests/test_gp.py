"""NumPy inference against Pyro, and the shipped file."""

from pathlib import Path

import numpy as np
import pytest

from avrare_gp_pem.runtime.gp import DiagonalGp, SparseGp
from avrare_gp_pem.runtime.store import FOLDER, load, locate, save
from avrare_pem_training.cleaning import off_axis
from perception_scenes import check_rows

DATA = Path(__file__).parents[4] / "shared" / "data" / "perception"


def small(latents=2, points=6, inputs=3, seed=0):
    rng = np.random.default_rng(seed)
    factor = np.tril(rng.normal(0, 0.2, (latents, points, points))) + 0.5 * np.eye(points)
    return {
        "inducing": rng.normal(size=(points, inputs)),
        "lengthscale": rng.uniform(0.5, 2, inputs),
        "variance": np.array(1.7),
        "location": rng.normal(size=(latents, points)),
        "factor": factor,
        "prior": rng.normal(size=(latents, 2)),
        "jitter": np.array(1e-5),
    }


def pyro_prediction(parameters, x):
    import pyro
    import torch
    from pyro.contrib import gp

    torch.set_num_threads(1)
    pyro.clear_param_store()
    tensor = {name: torch.as_tensor(value) for name, value in parameters.items()}
    prior = tensor["prior"]
    kernel = gp.kernels.RBF(x.shape[1], variance=tensor["variance"], lengthscale=tensor["lengthscale"])
    given = (torch.as_tensor(x), None, kernel, tensor["inducing"], gp.likelihoods.Gaussian())
    process = gp.models.VariationalSparseGP(
        *given,
        mean_function=lambda z: prior[:, :1] + prior[:, 1:] * z[:, 0],
        latent_shape=torch.Size([len(prior)]),
        whiten=True,
        jitter=float(parameters["jitter"]),
    )
    process.u_loc.data.copy_(tensor["location"])
    process.u_scale_tril = tensor["factor"]
    with torch.no_grad():
        mean, variance = process(torch.as_tensor(x))
    return mean.numpy().T, variance.numpy().T


def test_small_process_agrees_with_pyro():
    x = np.random.default_rng(1).normal(size=(100, 3))
    np.testing.assert_allclose(SparseGp(**small()).predict(x), pyro_prediction(small(), x), atol=1e-9)


@pytest.mark.parametrize("name", ["detection", "error"])
def test_shipped_process_agrees_with_pyro(pointpillars, name):
    process = getattr(pointpillars.clean.latents, name)
    x = np.random.default_rng(2).normal(0, 1.2, (300, 10))
    expected = pyro_prediction({key: getattr(process, key) for key in small()}, x)
    np.testing.assert_allclose(process.predict(x), expected, atol=1e-6)


def test_diagonal_factors_are_triangular_ones_without_the_rest():
    parameters = small(points=19)
    diagonals = np.diagonal(parameters["factor"], axis1=1, axis2=2).copy()
    full = SparseGp(**(parameters | {"factor": np.stack([np.diag(d) for d in diagonals])}))
    quick = DiagonalGp(**(parameters | {"factor": diagonals}))
    x = np.random.default_rng(5).normal(size=(70, 3))
    np.testing.assert_allclose(quick.predict(x), full.predict(x), atol=2e-4)


@pytest.mark.parametrize("model", ["pointpillars", "paper", "literal"])
@pytest.mark.parametrize("name", ["detection", "error"])
def test_rows_are_the_same_in_any_batch_and_place(model, name):
    process = getattr(load(locate(model)).clean.latents, name)
    check_rows(process.predict, process.inducing.shape[1])


def test_file_survives_a_round_trip(pointpillars, tmp_path):
    save(tmp_path / "copy.npz", pointpillars)
    again = load(locate(str(tmp_path / "copy.npz")))
    x = np.random.default_rng(4).normal(size=(10, 10))
    np.testing.assert_array_equal(again.clean.latents.predict(x), pointpillars.clean.latents.predict(x))
    assert again.provenance == pointpillars.provenance
    save(tmp_path / "twice.npz", again)
    assert (tmp_path / "twice.npz").read_bytes() == (tmp_path / "copy.npz").read_bytes()


@pytest.mark.parametrize("name", ["pointpillars", "paper", "literal", "best", "measured"])
def test_shipped_file_is_small_and_has_its_provenance(name):
    model = load(locate(name))
    assert (FOLDER / f"{name}.npz").stat().st_size < 1_000_000
    assert "CC BY-NC-SA 4.0" in model.provenance["licence"]
    assert "nuScenes" in model.provenance["data"]
    assert "CC BY-NC-SA 4.0" in (FOLDER / f"{name}.md").read_text()
    with np.load(FOLDER / f"{name}.npz", allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pointpillars", "paper"])
def test_inducing_points_are_not_rows_of_the_data(name):
    if not DATA.is_dir():
        pytest.skip("the training data is not here")
    from avrare_gp_pem.runtime.features import features
    from avrare_pem_training.text_tables import convert

    rows, model = convert(DATA / "nuscenes_inputs.txt", DATA / "nuscenes_labels.txt"), load(locate(name))
    for variant in (one for one in (model.clean, model.delivered) if one is not None):
        columns = variant.normalise(features(rows, variant.inputs))
        for process in (variant.latents.detection, variant.latents.error):
            nearest = min(np.abs(columns - point).max(axis=1).min() for point in process.inducing)
            assert nearest > 1e-3


def test_angle_to_the_nearest_axis():
    yaw = np.radians([0, 5, 85, 90, -95, 45, 179, -130])
    np.testing.assert_allclose(off_axis(yaw), [0, 5, 5, 0, 5, 45, 1, 40], atol=1e-9)
