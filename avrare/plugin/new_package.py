"""New plugin packages from templates: complete, and passing their own tests."""

from __future__ import annotations

import keyword
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from string import Template

from avrare.base.errors import UsageError, did_you_mean
from avrare.plugin.component import KINDS
from avrare.plugin.first_party import FIRST_PARTY
from avrare.plugin.registry import Registry

_TEMPLATES = Path(__file__).parent / "templates"
_NAME = re.compile(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*")
_MAX_LENGTH = 24

_SUMMARIES = {
    "simulator": "a point mass in gusty wind",
    "perception": "normally distributed position errors and missed detections",
    "tracker": "fixed-gain filter with constant-velocity prediction",
    "controller": "holds speed and lane, and brakes for vehicles ahead",
    "controller_plain": "feeds the observation back, for simulators without vehicles",
    "specification": "a signal must not exceed its limit for several steps in a row",
    "estimator": "fraction of failures among independent rollouts",
    "executor": "runs chunks on threads of this process",
}
_DRIVING = ("perception", "tracker", "controller")
_HEADERS = {"estimator": "from typing import ClassVar\n\n", "executor": ""}
_SUITE = "from avrare.testing.estimators import EstimatorConformance\n"


def check_name(name: str, kind: str, registry: Registry) -> str:
    """Check the kind and the name of a new component; return the name without a leading ``avrare-``."""
    if kind not in KINDS:
        raise UsageError(f"unknown kind {kind!r}", did_you_mean(kind, KINDS))
    short = name.removeprefix("avrare-")
    if keyword.iskeyword(short):
        raise UsageError(f"{name!r} is a Python keyword", "choose another name; for example wind_gusts")
    if not _NAME.fullmatch(short) or len(short) > _MAX_LENGTH:
        raise UsageError(
            f"{name!r} is not a valid plugin name",
            f"use lowercase letters and digits, '-' or '_' between them, at most {_MAX_LENGTH} characters; "
            "for example wind_gusts",
        )
    component = short.replace("-", "_")
    owner = FIRST_PARTY.get((kind, component)) or next(
        (row.distribution for row in registry.rows() if (row.kind, row.name) == (kind, component)), None
    )
    if owner is not None:
        raise UsageError(f"the {kind} {component!r} already exists in {owner}", "choose another name")
    return component


def write(name: str, kind: str, folder: Path, driving: bool = True) -> Path:
    """Write the package ``avrare-NAME`` into a new subfolder, and return that; ``name`` has been checked.

    Without ``driving`` a controller is written for simulators without vehicles.
    """
    if not driving and kind != "controller":
        text = (
            "perception error models and trackers are about vehicles"
            if kind in _DRIVING
            else f"no {kind} needs it"
        )
        raise UsageError("--no-driving is for controllers", text)
    words = _placeholders(name, kind, driving)
    target = folder / words["distribution"]
    try:
        if target.exists():
            raise UsageError(f"{target}: already exists", "choose another name or --out")
        unfinished = target.with_name(f".{target.name}.new")  # of a killed command, perhaps
        shutil.rmtree(unfinished, ignore_errors=True)
        for path, text in _files(words).items():
            (unfinished / path).parent.mkdir(parents=True, exist_ok=True)
            (unfinished / path).write_text(text, encoding="utf-8")
        unfinished.rename(target)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UsageError(f"{error.filename or target}: cannot be written: {reason}") from None
    return target


def _placeholders(name: str, kind: str, driving: bool) -> dict[str, str]:
    variant = kind if driving else f"{kind}_plain"
    words = {
        "name": name,
        "Name": "".join(part.capitalize() for part in name.split("_")),
        "kind": kind,
        "Article": "An" if kind[0] in "aeiou" else "A",
        "distribution": "avrare-" + name.replace("_", "-"),
        "package": f"avrare_{name}",
        "module": kind,
        "summary": _SUMMARIES[variant],
        "extras": "\n            driving=True," if driving and kind in _DRIVING else "",
        "variant": variant,
        "test_header": _HEADERS.get(kind, "import numpy as np\n"),
        "test_footer": _SUITE if kind == "estimator" else "",
    }
    for part in ("test", "example"):
        words[part] = _fill(f"{part}_{variant}.txt", words).rstrip("\n")
    return {**words, "options": _fill(f"config_{variant}.txt", words).rstrip("\n")}


def _files(words: Mapping[str, str]) -> dict[str, str]:
    source, kind = f"src/{words['package']}", words["kind"]
    templates = {
        "pyproject.toml": "pyproject.toml.txt",
        "README.md": "README.md.txt",
        f"{source}/__init__.py": "init.py.txt",
        f"{source}/config.py": "config.py.txt",
        f"{source}/{kind}.py": f"part_{words['variant']}.txt",
        f"tests/test_{words['package']}.py": "test.py.txt",
    }
    return {**{path: _fill(file, words) for path, file in templates.items()}, f"{source}/py.typed": ""}


def _fill(file: str, words: Mapping[str, str]) -> str:
    return Template((_TEMPLATES / file).read_text(encoding="utf-8")).substitute(words)
