"""New plugin packages from templates: complete, and passing their own tests."""

from __future__ import annotations

import keyword
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

from avrare.base.errors import UsageError, did_you_mean
from avrare.plugin.component import KINDS
from avrare.plugin.first_party import FIRST_PARTY
from avrare.plugin.registry import Registry

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


def check_name(name: str, kinds: Sequence[str], registry: Registry) -> str:
    """Check the kinds and the name of new components; return the name without a leading ``avrare-``."""
    for kind in kinds:
        if kind not in KINDS:
            raise UsageError(f"unknown kind {kind!r}", did_you_mean(kind, KINDS))
    short = name.removeprefix("avrare-")
    if keyword.iskeyword(short):
        raise UsageError(f"{name!r} is a Python keyword", "choose another name; for example wind_gusts")
    longest = 24
    if not re.fullmatch(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*", short) or len(short) > longest:
        raise UsageError(
            f"{name!r} is not a valid plugin name",
            f"use lowercase letters and digits, '-' or '_' between them, at longest {longest} characters; "
            "for example wind_gusts",
        )
    component = short.replace("-", "_")
    for kind in kinds:
        owner = FIRST_PARTY.get((kind, component)) or next(
            (row.distribution for row in registry.rows() if (row.kind, row.name) == (kind, component)), None
        )
        if owner is not None:
            raise UsageError(f"the {kind} {component!r} already exists in {owner}", "choose another name")
    return component


def write(name: str, kinds: Sequence[str], folder: Path, driving: bool = True) -> Path:
    """Write the package ``avrare-NAME`` into a new subfolder, and return that; ``name`` has been checked.

    Without ``driving``, and beside a simulator, a controller is written for simulators without vehicles.
    """
    if not driving and "controller" not in kinds:
        text = (
            "perception error models and trackers are about vehicles"
            if set(kinds) & set(_DRIVING)
            else f"no {kinds[0]} needs it"
        )
        raise UsageError("--no-driving is for controllers", text)
    driving = driving and "simulator" not in kinds
    target = folder / f"avrare-{name.replace('_', '-')}"
    try:
        if target.exists():
            raise UsageError(f"{target}: already exists", "choose another name or --out")
        unfinished = target.with_name(f".{target.name}.new")  # of a killed command, perhaps
        shutil.rmtree(unfinished, ignore_errors=True)
        for path, text in _files(name, kinds, driving).items():
            (unfinished / path).parent.mkdir(parents=True, exist_ok=True)
            (unfinished / path).write_text(text, encoding="utf-8")
        unfinished.rename(target)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UsageError(f"{error.filename or target}: cannot be written: {reason}") from None
    return target


def _files(name: str, kinds: Sequence[str], driving: bool) -> dict[str, str]:
    package, title = f"avrare_{name}", ", ".join(kinds).capitalize()
    words = {"name": name, "distribution": package.replace("_", "-"), "package": package, "title": title}
    files, components, sections = {}, "", ""
    for kind in kinds:
        kind_words = {**words, **_placeholders(name, kind, driving)}
        variant = kind_words["variant"]
        kind_words |= {
            part: _fill(f"{part}_{variant}.txt", kind_words).rstrip("\n")
            for part in ("test", "example", "config")
        }
        files[f"src/{package}/{kind}_config.py"] = _fill("config.py.txt", kind_words)
        files[f"src/{package}/{kind}.py"] = _fill(f"part_{variant}.txt", kind_words)
        files[f"tests/test_{package}_{kind}.py"] = _fill("test.py.txt", kind_words)
        components += _fill("component.txt", kind_words)
        sections += "\n" + _fill("section.md.txt", kind_words)
    return {
        "pyproject.toml": _fill("pyproject.toml.txt", words),
        "README.md": _fill("README.md.txt", words) + sections,
        f"src/{package}/__init__.py": _fill("init.py.txt", {**words, "components": components.rstrip("\n")}),
        f"src/{package}/py.typed": "",
        **files,
    }


def _placeholders(name: str, kind: str, driving: bool) -> dict[str, str]:
    variant = "controller_plain" if kind == "controller" and not driving else kind
    suite = "from avrare.testing.estimators import EstimatorConformance\n"
    return {
        "Name": "".join(word.capitalize() for word in name.split("_")),
        "kind": kind,
        "summary": _SUMMARIES[variant],
        "extras": "\n            driving=True," if kind in _DRIVING and variant == kind else "",
        "variant": variant,
        "test_header": _HEADERS.get(kind, "import numpy as np\n"),
        "test_footer": suite if kind == "estimator" else "",
    }


def _fill(file: str, words: Mapping[str, str]) -> str:
    template = Path(__file__).parent / "templates" / file
    return Template(template.read_text(encoding="utf-8")).substitute(words)
