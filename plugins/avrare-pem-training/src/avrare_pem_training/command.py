"""``avrare pem``: fit a perception error model to a detector's output, convert data, score a model."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from avrare.base.errors import ExitCode, PluginError, UsageError

if TYPE_CHECKING:
    from avrare_pem_training.cleaning import CleanedData

_ARTEFACT = {"auto": None, "yes": True, "no": False}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the three commands."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    fit = commands.add_parser("fit", help="fit, calibrate, score and describe a model", allow_abbrev=False)
    _add_data(fit)
    fit.add_argument(
        "--model",
        choices=("gp", "mlp", "student", "logistic", "literal"),
        default="mlp",
        help="Gaussian processes, networks (the default), linear with Student-t errors, a baseline, or the "
        "Gaussian processes of the STL-AMS paper to the letter",
    )
    fit.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    fit.add_argument("--name", default="model", help="name of the model's files")
    fit.add_argument(
        "--ensemble",
        type=_members,
        default=0,
        metavar="K",
        help="keep K refits to bootstrap samples of the data in the file, for intervals with the model",
    )
    fit.add_argument("--seed", type=_seed, default=0, metavar="N", help="same seed, same machine: same bytes")
    for option, text in (
        ("--licence", "licence of the data, for the model card"),
        ("--source", "description of the data, for the model card"),
        ("--detector", "the detector, for the model card"),
    ):
        fit.add_argument(option, default="not stated", metavar="TEXT", help=text)
    convert = commands.add_parser("convert", help="make the CSV from two text files", allow_abbrev=False)
    convert.add_argument("inputs", type=Path, metavar="INPUTS", help="annotated vehicles, one a line")
    convert.add_argument("labels", type=Path, metavar="LABELS", help="their detections, line by line")
    convert.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of INPUTS.csv")
    convert.add_argument(
        "--period",
        type=_period,
        metavar="SECONDS",
        help="time between frames: adds track and time, taking boxes of exactly one size for one vehicle",
    )
    score = commands.add_parser("score", help="score a model on the last fifth of a CSV", allow_abbrev=False)
    score.add_argument("model", metavar="MODEL", help="name of a shipped model, or path of an .npz file")
    _add_data(score)
    score.add_argument("--json", action="store_true", help="print a JSON object")


def _seed(text: str) -> int:
    if not text.isdecimal() or len(text) > 9:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer from 0 to 999999999")
    return int(text)


def _members(text: str) -> int:
    most_members = 100
    if not text.isdecimal() or not (text == "0" or 3 <= int(text) <= most_members):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 3 to {most_members}")
    return int(text)


def _period(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time [s]")
    return seconds


def _add_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "data",
        type=Path,
        metavar="DATA",
        help="CSV of annotated vehicles in the order of recording: right, forward, yaw, length, width, "
        "height, visibility, detected, error_right, error_forward, error_yaw, track, time, ghost "
        "[m, rad, s]; see docs/perception.md",
    )
    parser.add_argument(
        "--artefact",
        choices=tuple(_ARTEFACT),
        default="auto",
        help="whether detections were matched by boxes along the ego's axes; auto: detect it",
    )


def execute(args: argparse.Namespace) -> int:
    """Run one of the three commands."""
    {"fit": _fit, "convert": _convert, "score": _score}[args.action](args)
    return int(ExitCode.PASS)


def _convert(args: argparse.Namespace) -> None:
    from avrare_pem_training.table import write_table
    from avrare_pem_training.text_tables import convert
    from avrare_pem_training.tracks import link_by_size

    rows = convert(args.inputs, args.labels)
    if args.period is not None:
        rows = link_by_size(rows, args.period)
    _make_folder(args.out)
    file = args.out / f"{args.inputs.stem}.csv"
    write_table(file, rows)
    print(f"{file}: {len(rows)} rows, {int(rows.detected.sum())} detected")


def _fit(args: argparse.Namespace) -> None:
    _require_modules("torch", "scipy", "matplotlib", *(["pyro"] if args.model in ("gp", "literal") else []))
    if Path(args.name).name != args.name or args.name in ("", ".."):
        raise UsageError(f"--name: {args.name!r} is not a file name", "the folder goes into --out")
    from avrare_pem_training.bootstrap import fit_ensemble
    from avrare_pem_training.pipeline import FitPlan, fit_model
    from avrare_pem_training.report import provenance, write_report

    data = _read_data(args)
    _make_folder(args.out)
    plan = FitPlan(args.model, args.seed)
    stated = {"data": args.source, "detector": args.detector, "licence": args.licence}
    fit = fit_model(data, plan, provenance(plan, data, stated), _log)
    model = fit_ensemble(fit, data, args.ensemble, _log)
    for line in write_report(args.out, args.name, model, data):
        print(line)


def _score(args: argparse.Namespace) -> None:
    _require_modules("scipy")
    from avrare_gp_pem.runtime.store import load, locate
    from avrare_pem_training.report import as_json, summary
    from avrare_pem_training.scores import evaluate, yaw_scores

    data, model = _read_data(args), load(locate(args.model))
    scores = {name: part.scores for name, part in evaluate(model, data).items()}
    if args.json:
        print(as_json(scores | {"yaw": yaw_scores(model, data)}))
        return
    for line in summary(scores):
        print(line)


def _read_data(args: argparse.Namespace) -> CleanedData:
    from avrare_pem_training.cleaning import clean
    from avrare_pem_training.table import read_log

    rows, ghosts = read_log(args.data)
    try:
        data = clean(rows, _ARTEFACT[args.artefact], ghosts)
    except UsageError as error:
        raise UsageError(f"{args.data}: {error.message}", error.hint) from None
    _log(f"{len(data.train)} training rows ({data.dropped} duplicates dropped), {len(data.test)} held out")
    _log(_describe_artefact(data))
    return data


def _describe_artefact(data: CleanedData) -> str:
    test, action = data.artefact, "taken out" if data.has_artefact else "left in"
    if not test.is_measured:
        return f"too few vehicles along the ego's axes to look for an artefact of matching: {action}"
    return (
        f"detected along the ego's axes {test.aligned:.2f}, off them {test.oblique:.2f} at the same range: "
        f"artefact of matching {'found' if test.present else 'not found'}, {action}"
    )


def _require_modules(*modules: str) -> None:
    from importlib.util import find_spec

    missing = [module for module in modules if find_spec(module) is None]
    if missing:
        raise PluginError(
            f"avrare pem needs {', '.join(missing)}", "pip install 'avrare-pem-training[train]'"
        )


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{path}: the folder cannot be created: {error.strerror}") from None


def _log(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
