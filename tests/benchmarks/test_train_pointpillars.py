"""Training of the published model: reading its data, and a small fit."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from avrare_gp_pem.runtime.store import load

_SOURCE = Path(__file__).parents[2] / "benchmarks" / "train_pointpillars.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("train_pointpillars", _SOURCE)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def write(folder, n, seed=0):
    """Write made-up rows: seen up to 40 m and hardly beyond, errors that grow with range."""
    rng = np.random.default_rng(seed)
    distance, bearing = rng.uniform(3, 80, n), rng.uniform(-np.pi, np.pi, n)
    yaw = rng.uniform(-np.pi, np.pi, n)
    sizes = rng.normal([4.6, 1.9, 1.7], 0.1, (n, 3))
    inputs = np.column_stack(
        [distance * np.cos(bearing), distance * np.sin(bearing), yaw, sizes, rng.integers(1, 5, n)]
    )
    detected = rng.uniform(size=n) < np.where(distance < 40, 0.95, 0.1)
    errors = 0.01 * distance[:, None] * rng.standard_t(3, (n, 2))
    labels = np.column_stack([detected, errors, np.zeros(n)])
    labels[~detected, 1:] = -1000
    np.savetxt(folder / "inputs.txt", inputs, fmt="%.3f", header="inputs")
    np.savetxt(folder / "labels.txt", labels, fmt="%.3f", header="labels")
    return inputs, labels


def test_read_drops_duplicates_and_axis_aligned_rows(script, tmp_path):
    inputs, labels = write(tmp_path, 200)
    rows = [np.vstack([part, part[:20]]) for part in (inputs, labels)]
    np.savetxt(tmp_path / "inputs.txt", rows[0], fmt="%.3f")
    np.savetxt(tmp_path / "labels.txt", rows[1], fmt="%.3f")
    train, test = script.read(tmp_path / "inputs.txt", tmp_path / "labels.txt", 0.0)
    assert (len(train.detected), len(test.detected)) == (160, 40)
    np.testing.assert_allclose(test.inputs[:, 0], np.hypot(*inputs[160:, :2].T), atol=0.002)  # order is kept
    kept = [
        len(part.detected) for part in script.read(tmp_path / "inputs.txt", tmp_path / "labels.txt", 10.0)
    ]
    off = np.abs((np.degrees(inputs[:, 2]) + 45) % 90 - 45)
    assert sum(kept) == (off >= 10).sum()


def test_errors_keep_their_length_and_are_missing_where_missed(script, tmp_path):
    _, labels = write(tmp_path, 300)
    train, test = script.read(tmp_path / "inputs.txt", tmp_path / "labels.txt", 0.0)
    errors = np.concatenate([train.errors, test.errors])
    detected = labels[:, 0] == 1
    np.testing.assert_array_equal(np.isnan(errors[:, 0]), ~detected)
    length = np.hypot(*labels[detected, 1:3].T)
    np.testing.assert_allclose(np.hypot(*errors[detected].T), length, atol=0.002)


def test_wrong_columns_are_refused(script, tmp_path):
    np.savetxt(tmp_path / "inputs.txt", np.zeros((3, 6)))
    np.savetxt(tmp_path / "labels.txt", np.zeros((3, 4)))
    with pytest.raises(ValueError, match="expected 7 columns"):
        script.read(tmp_path / "inputs.txt", tmp_path / "labels.txt", 10.0)


@pytest.mark.slow
def test_small_fit_learns_and_repeats_itself(script, tmp_path):
    write(tmp_path, 1500)
    common = ["--inputs", str(tmp_path / "inputs.txt"), "--labels", str(tmp_path / "labels.txt")]
    common += [
        "--inducing",
        "12",
        "--steps",
        "150",
        "--batch",
        "128",
        "--weight",
        "1",
        "--provenance",
        "licence=none",
    ]
    script.main([*common, "--out", str(tmp_path / "a")])
    script.main([*common, "--out", str(tmp_path / "b")])
    assert (tmp_path / "a/model.npz").read_bytes() == (tmp_path / "b/model.npz").read_bytes()
    report = json.loads((tmp_path / "a/model.json").read_text())
    assert report["detection_nll"] < 0.75 * report["detection_base_nll"]
    assert report["detection_auc"] > 0.85
    for axis in ("along", "across"):
        assert report[f"error_beyond_4_{axis}"] < 0.02
        assert 0.2 < report[f"error_beyond_1_{axis}"] < 0.45
    for bounds in report["bounds"].values():
        assert bounds[-1] > bounds[0]
    assert load(tmp_path / "a/model.npz").provenance["licence"] == "none"
