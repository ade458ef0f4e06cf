"""``avrare pem``: fit a perception error model to a detector's output, convert data, score a model."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from avrare.errors import ExitCode, PluginError, UsageError

if TYPE_CHECKING:
    from avrare_gp_pem.clean import Cleaned

_DATA = (
    "CSV of annotated vehicles in the order of recording: right, forward, yaw, length, width, height, "
    "visibility, detected, error_right, error_forward, error_yaw [m, rad]; see docs/perception.md"
)
MODELS = ("gp", "mlp", "student", "logistic")
_ARTEFACT = {"auto": None, "yes": True, "no": False}
_MOST_DIGITS = 9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the three commands."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    fit = commands.add_parser("fit", help="fit, calibrate, score and describe a model", allow_abbrev=False)
    _add_data(fit)
    fit.add_argument(
        "--model",
        choices=MODELS,
        default="mlp",
        help="Gaussian processes, networks (the default), linear with Student-t errors, or a baseline",
    )
    fit.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    fit.add_argument("--name", default="model", help="name of the model's files")
    fit.add_argument("--seed", type=_seed, default=0, help="same seed, same machine: same bytes")
    fit.add_argument("--licence", default="not stated", metavar="TEXT", help="of the data, for the card")
    fit.add_argument("--source", default="not stated", metavar="TEXT", help="what the data is, for the card")
    fit.add_argument(
        "--detector", default="not stated", metavar="TEXT", help="whose detections, for the card"
    )
    convert = commands.add_parser("convert", help="make the CSV from two text files", allow_abbrev=False)
    convert.add_argument("inputs", type=Path, metavar="INPUTS", help="annotated vehicles, one a line")
    convert.add_argument("labels", type=Path, metavar="LABELS", help="their detections, line by line")
    convert.add_argument("--out", type=Path, required=True, metavar="CSV", help="file to write")
    score = commands.add_parser("score", help="score a model on the last fifth of a CSV", allow_abbrev=False)
    score.add_argument("model", metavar="MODEL", help="name of a shipped model, or path of an .npz file")
    _add_data(score)
    score.add_argument("--json", action="store_true", help="print an object")


def _seed(text: str) -> int:
    if not text.isdecimal() or len(text) > _MOST_DIGITS:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def _add_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("data", type=Path, metavar="DATA", help=_DATA)
    parser.add_argument(
        "--artefact",
        choices=tuple(_ARTEFACT),
        default="auto",
        help="whether detections were matched by boxes along the ego's axes; auto: look for it",
    )


def execute(args: argparse.Namespace) -> int:
    """Run one of them."""
    {"fit": _fit, "convert": _convert, "score": _score}[args.action](args)
    return int(ExitCode.PASS)


def _convert(args: argparse.Namespace) -> None:
    from avrare_gp_pem.convert import convert
    from avrare_gp_pem.table import write

    rows = convert(args.inputs, args.labels)
    _folder(args.out.parent)
    write(args.out, rows)
    print(f"{args.out}: {len(rows)} rows, {int(rows.detected.sum())} detected")


def _fit(args: argparse.Namespace) -> None:
    _need("torch", "scipy", "matplotlib", *(["pyro"] if args.model == "gp" else []))
    if Path(args.name).name != args.name or args.name in ("", ".."):
        raise UsageError(f"--name: {args.name!r} is no name of a file", "the folder goes into --out")
    from avrare_gp_pem.fitting import Plan, fit_model
    from avrare_gp_pem.report import provenance, write_report

    data = _data(args)
    _folder(args.out)
    plan = Plan(args.model, args.seed)
    given = {"data": args.source, "detector": args.detector, "licence": args.licence}
    model = fit_model(data, plan, provenance(plan, data, given), _say)
    for line in write_report(args.out, args.name, model, data):
        print(line)


def _score(args: argparse.Namespace) -> None:
    _need("scipy")
    from avrare_gp_pem.evaluate import evaluate, yaw_scores
    from avrare_gp_pem.report import as_json, summary
    from avrare_gp_pem.store import load, locate

    data, model = _data(args), load(locate(args.model))
    scores = {name: one.scores for name, one in evaluate(model, data).items()}
    if args.json:
        print(as_json(scores | {"yaw": yaw_scores(model, data)}))
        return
    for line in summary(scores):
        print(line)


def _data(args: argparse.Namespace) -> Cleaned:
    from avrare_gp_pem.clean import clean
    from avrare_gp_pem.table import read

    rows = read(args.data)
    try:
        data = clean(rows, _ARTEFACT[args.artefact])
    except UsageError as error:
        raise UsageError(f"{args.data}: {error.message}", error.hint) from None
    _say(f"{len(data.train)} training rows ({data.dropped} duplicates dropped), {len(data.test)} held out")
    _say(_artefact(data))
    return data


def _artefact(data: Cleaned) -> str:
    """What was found, and what is made of it."""
    found, taken = data.artefact, "taken out" if data.has_artefact else "left in"
    if not found.known:
        return f"too few vehicles along the ego's axes to look for an artefact of matching: {taken}"
    return (
        f"detected along the ego's axes {found.aligned:.2f}, off them {found.oblique:.2f} at the same range: "
        f"artefact of matching {'found' if found.present else 'not found'}, {taken}"
    )


def _need(*modules: str) -> None:
    from importlib.util import find_spec

    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise PluginError(f"avrare pem needs {', '.join(missing)}", "pip install 'avrare-gp-pem[train]'")


def _folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path}: cannot be made a folder: {error.strerror}") from None


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
