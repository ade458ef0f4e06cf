"""Command ``avrare flow fit``: fit a flow to samples of noise."""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import numpy as np

from avrare.base.atomic_files import ensure_writable
from avrare.base.errors import ExitCode, PluginError, UsageError
from avrare.protocols import Floats


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("action", choices=("fit",), help="action")
    parser.add_argument("samples", metavar="SAMPLES", help=".npy file, or .csv with a line of names or none")
    parser.add_argument("--out", required=True, metavar="DIR", help="write SAMPLES.npz into this folder")
    parser.add_argument(
        "--kind",
        choices=("affine_coupling", "spline_autoregressive"),
        help="kind of flow; affine_coupling needs two columns",
    )
    parser.add_argument("--steps", type=int, default=2000, metavar="N", help="training steps (2000)")
    parser.add_argument("--blocks", type=int, metavar="N", help="blocks of the flow (6 couplings, 2 splines)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the fit (0)")


def execute(args: argparse.Namespace) -> int:
    """Fit and write a flow, and print its quality on held-out samples."""
    ensure_writable(Path(args.out), "--out")
    file = Path(args.out) / f"{Path(args.samples).stem}.npz"
    samples = read_samples(Path(args.samples))
    try:
        from avrare_flows.train import fit
    except ImportError as error:
        reason = f"fitting a flow needs torch and pyro-ppl: {error}"
        raise PluginError(reason, "pip install torch pyro-ppl") from error
    kind = args.kind or ("affine_coupling" if samples.shape[1] > 1 else "spline_autoregressive")
    fitted = fit(samples, kind, steps=args.steps, seed=args.seed, blocks=args.blocks)
    fitted.flow.save(file)
    numbers = f"{samples.shape[1]} number{'s' if samples.shape[1] > 1 else ''}"
    print(f"{file}: {kind}, {numbers} a row, {len(samples)} samples")
    print(f"log density of held-out samples: {fitted.held_out:.4f} nat a row (step {fitted.step})")
    print(f"log density of a normal law:     {fitted.normal:.4f}")
    if fitted.held_out < fitted.normal:
        print("a normal law is as good as the flow: try more steps, another kind, or no flow at all")
    return int(ExitCode.PASS)


def read_samples(path: Path) -> Floats:
    """Read rows (M, n) from a file.

    Raises:
        UsageError: It cannot be read, or is not a table of numbers.
    """
    try:
        if path.suffix == ".npy":
            # Mapped, a header that promises more than the file has is an error before any memory is taken
            table = np.load(path, mmap_mode="r", allow_pickle=False)
            if np.iscomplexobj(table):
                raise ValueError("its numbers are complex")
        else:
            with path.open(encoding="utf-8-sig") as file:  # a byte order mark is no name
                names = any(not _number(word) for word in file.readline().split(","))
            with warnings.catch_warnings():  # an empty file is reported below
                warnings.simplefilter("ignore", UserWarning)
                table = np.loadtxt(path, delimiter=",", skiprows=int(names), ndmin=2, encoding="utf-8-sig")
        rows = np.asarray(table, dtype=np.float64)
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    except MemoryError:
        raise
    except Exception as error:  # NumPy raises many kinds of errors for a damaged header
        raise UsageError(f"{path}: not a table of numbers: {error}", "one row of noise a line") from error
    rows = rows[:, None] if rows.ndim == 1 else rows
    if not rows.size:
        raise UsageError(f"{path}: holds no row of noise")
    if rows.ndim != 2:
        raise UsageError(f"{path}: has shape {rows.shape}, not rows of noise (M, n)")
    return rows


def _number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
