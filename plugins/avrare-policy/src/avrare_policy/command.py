"""Command ``avrare policy convert``: write a trained network as a policy file."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from avrare.base.atomic_files import ensure_writable, explain_file_errors
from avrare.base.errors import ExitCode, UsageError
from avrare_policy.network import ACTIVATIONS, save


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("action", choices=("convert",), help="action")
    parser.add_argument("file", metavar="FILE", help="stable-baselines3 archive (.zip), or torch state dict")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the FILE.npz to write")
    parser.add_argument("--activation", choices=tuple(ACTIVATIONS), help="by default that of the library")
    parser.add_argument("--low", type=float, default=-math.inf, metavar="X", help="least action (none)")
    parser.add_argument("--high", type=float, default=math.inf, metavar="X", help="largest action (none)")
    parser.add_argument(
        "--squash",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="tanh squashes the last layer into the range of the action; by default as the library does",
    )


def execute(args: argparse.Namespace) -> int:
    """Convert the file and print how it was read."""
    from avrare_policy.convert import convert

    out = Path(args.out) / f"{Path(args.file).stem}.npz"
    if not args.low < args.high:
        raise UsageError(f"--low {args.low:g} is not below --high {args.high:g}")
    network, layout = convert(
        Path(args.file), activation=args.activation, low=args.low, high=args.high, squash=args.squash
    )
    ensure_writable(out.parent, "--out")
    with explain_file_errors(f"{out}: cannot write", "choose another --out"):
        save(out, network)
    sizes = "-".join(map(str, (network.inputs, *(len(bias) for bias in network.biases))))
    squashed = ", squashed by tanh" if network.squash else ""
    print(f"{out}: {sizes}, {network.activation}{squashed}; read as {layout.name}")
    print(f"next: controller: {{plugin: policy, model: {out}}}")
    return int(ExitCode.PASS)
