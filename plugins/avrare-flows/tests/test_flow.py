"""Flows: the arrays compute what Pyro computes, files hold them, fits come near the truth."""

import numpy as np
import pytest
import torch

from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare_flows import train
from avrare_flows.command import read_samples
from avrare_flows.flow import Flow

COUPLING, SPLINE = "affine_coupling", "spline_autoregressive"
SHAPES = [(COUPLING, 2), (COUPLING, 3), (SPLINE, 3), (SPLINE, 1)]


def rough(kind, size, seed=1):
    """Return Pyro's transforms with weights that bend a lot, and the same as a flow."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        parts = [train._pyro_transforms(kind, size, 16) for _ in range(3)]
        for network in train._networks(parts):
            for weight in network.parameters():
                weight.data.normal_(0.0, 0.5)
    flow = Flow(kind, train._export(parts), np.linspace(-1.0, 1.0, size), np.linspace(0.5, 2.0, size), 7)
    return [transform for part in parts for transform in part], flow


@pytest.mark.parametrize(("kind", "size"), SHAPES)
def test_a_flow_computes_what_pyro_computes(kind, size):
    transforms, flow = rough(kind, size)
    z = 2.0 * np.random.default_rng(0).standard_normal((500, size))
    now, log_det = torch.from_numpy(z), torch.zeros(len(z), dtype=torch.float64)
    with torch.no_grad():
        for transform in transforms:
            then = transform(now)
            log_det = log_det + transform.log_abs_det_jacobian(now, then)
            now = then
    x, found = flow.warp(z)
    np.testing.assert_allclose(x, flow.shift + flow.scale * now.numpy(), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found, log_det.numpy() + np.log(flow.scale).sum(), rtol=1e-9, atol=1e-9)
    assert np.array_equal(flow.physical(z), x)


@pytest.mark.parametrize(("kind", "size"), SHAPES)
def test_the_determinant_is_that_of_the_map(kind, size):
    _, flow = rough(kind, size, seed=2)
    z, step = np.random.default_rng(1).standard_normal((10, size)), 1e-6
    moved = [(flow.physical(z + step * e) - flow.physical(z - step * e)) / (2.0 * step) for e in np.eye(size)]
    expected = np.linalg.slogdet(np.stack(moved, axis=2))[1]
    np.testing.assert_allclose(flow.warp(z)[1], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("kind", "size"), SHAPES)
def test_a_file_holds_all_of_a_flow(kind, size, tmp_path):
    _, flow = rough(kind, size)
    flow.save(tmp_path / "flow.npz")
    again, z = Flow.load(tmp_path / "flow.npz"), np.random.default_rng(3).standard_normal((20, size))
    for one, other in zip(flow.warp(z), again.warp(z), strict=True):
        assert np.array_equal(one, other)
    assert "fitted to 7 samples" in again.note


def test_an_invalid_flow_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", format=1, kind="other")
    (tmp_path / "text.npz").write_text("no zip")
    rough("affine_coupling", 2)[1].save(tmp_path / "flow.npz")
    whole = (tmp_path / "flow.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    middle = len(whole) // 2
    (tmp_path / "bit.npz").write_bytes(whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :])
    with np.load(tmp_path / "flow.npz") as file:
        arrays = dict(file)
    for name, change in (
        ("blocks", {"blocks": 9}),
        ("endless", {"blocks": 2**62}),  # was built for hours
        ("empty", {"blocks": 0}),
        ("unfitted", {"samples": -1}),
        ("size", {"shift": np.zeros(3), "scale": np.ones(3)}),
        ("nan", {"0.weight0": np.nan * arrays["0.weight0"]}),
    ):
        np.savez(tmp_path / f"{name}.npz", **{**arrays, **change})
    for name, text in (
        *((f"{name}.npz", "not a flow") for name in ("half", "bit", "size", "nan")),
        *((f"{name}.npz", "blocks of which") for name in ("blocks", "endless", "empty", "unfitted")),
        ("other.npz", "not a flow"),
        ("text.npz", r"not a flow \(not an .npz file\)"),
        ("none.npz", "cannot be read"),
    ):
        with pytest.raises(UsageError, match=text):
            Flow.load(tmp_path / name)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "steps"), [("affine_coupling", 600), ("spline_autoregressive", 150)])
def test_a_fit_comes_nearer_to_bent_samples_than_a_normal_law(kind, steps):
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((4000, 2))
    rows[:, 1] += rows[:, 0] ** 2  # the entropy stays that of two normal numbers, 2.838 nat
    found = train.fit(rows, kind, steps=steps, seed=1)
    assert found.held_out > found.normal + 0.25
    assert found.held_out < -2.838 + 0.1
    drawn = found.flow.physical(rng.standard_normal((4000, 2)))
    found, expected = (np.corrcoef(table[:, 0] ** 2, table[:, 1])[0, 1] for table in (drawn, rows))
    assert abs(found - expected) < 0.1


@pytest.mark.slow
def test_a_fit_is_a_function_of_its_seed():
    rows = np.random.default_rng(0).exponential(size=(300, 2))
    state = torch.random.get_rng_state()
    first, again, other = (train.fit(rows, steps=20, seed=seed).flow for seed in (3, 3, 4))
    assert torch.equal(state, torch.random.get_rng_state())
    z = rows[:10]
    assert np.array_equal(first.physical(z), again.physical(z))
    assert not np.array_equal(first.physical(z), other.physical(z))


ROWS = np.random.default_rng(0).normal(size=(100, 2))


@pytest.mark.parametrize(
    ("rows", "kind", "text"),
    [
        (np.zeros((100, 2)), COUPLING, "constant"),
        (ROWS[:, :1], COUPLING, "two numbers"),
        (ROWS[:9], COUPLING, r"shape \(9, 2\)"),
        (np.full((100, 2), np.nan), COUPLING, "not finite"),
        (np.r_[np.eye(99, 2), [[1.5, np.inf]]], COUPLING, "row 100 of the samples, 1.5, inf, is not"),
        (ROWS * [1, 0], COUPLING, "column 2 of the samples"),
        (np.full((300, 2), 0.1), COUPLING, "constant"),  # its standard deviation is 1e-17
        (np.eye(300)[:, :2], COUPLING, "constant"),  # the numbers that differ are held out
        (1e300 * ROWS, COUPLING, "too large"),
        (ROWS, "affine_couplings", "unknown kind"),
    ],
)
def test_samples_that_no_flow_fits_are_refused(rows, kind, text):
    with pytest.raises(UsageError, match=text):
        train.fit(rows, kind, steps=1)


@pytest.mark.parametrize("name", ["samples.npy", "samples.csv", "named.csv"])
def test_the_command_fits_a_file(name, tmp_path, capsys):
    rows = np.random.default_rng(0).exponential(size=(200, 2))
    path = tmp_path / name
    if name.endswith("npy"):
        np.save(path, rows)
    else:
        header = "a,b" if name == "named.csv" else ""
        np.savetxt(path, rows, delimiter=",", header=header, comments="")
    assert main(["flow", "fit", str(path), "--out", str(tmp_path / "fits"), "--steps", "5"]) == 0
    assert "2 numbers a row, 200 samples" in capsys.readouterr().out
    assert Flow.load(tmp_path / "fits" / f"{path.stem}.npz").noise_size == 2


@pytest.mark.parametrize("text", [None, "a,b\n1,x\n", ""])
def test_the_command_refuses_files_that_are_not_tables(text, tmp_path, capsys):
    path = tmp_path / "samples.csv"
    if text is not None:
        path.write_text(text)
    assert main(["flow", "fit", str(path), "--out", str(tmp_path / "fits")]) == 4
    assert "samples.csv" in capsys.readouterr().err
    assert not (tmp_path / "f.npz").exists()


def test_a_byte_order_mark_loses_no_row(tmp_path):
    path = tmp_path / "samples.csv"
    path.write_text("1,2\n3,4\n", encoding="utf-8-sig")
    assert read_samples(path).tolist() == [[1.0, 2.0], [3.0, 4.0]]
