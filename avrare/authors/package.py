"""A new plugin package: complete, and passing its own tests as it is."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from pathlib import Path
from string import Template

from avrare.errors import UsageError, did_you_mean
from avrare.plugin.component import KINDS
from avrare.plugin.known import FIRST_PARTY
from avrare.plugin.registry import Registry

_TEMPLATES = Path(__file__).parent / "templates"
_NAME = re.compile(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*")
_MOST = 24
"""Characters of a name."""

_SUMMARIES = {
    "simulator": "a mass in gusts",
    "perception": "normal errors, and vehicles that are missed",
    "tracker": "a filter of fixed gain, and straight on as prediction",
    "controller": "holds speed and lane, and brakes for what is ahead",
    "specification": "a signal may be above its limit, but not for long",
    "estimator": "the share of failures among fresh rollouts",
    "executor": "chunks on threads of this process",
}
_DRIVING = ("perception", "tracker", "controller")
_HEADERS = {"estimator": "from typing import ClassVar\n\n", "executor": ""}
_SUITE = "from avrare.testing.estimators import EstimatorConformance\n"


def check_name(name: str, kind: str, registry: Registry) -> str:
    """The name of a component, without a leading ``avrare-``.

    Raises:
        UsageError: It is no name, or taken, or there is no such kind.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown kind {kind!r}", did_you_mean(kind, KINDS))
    short = name.removeprefix("avrare-")
    if keyword.iskeyword(short):
        raise UsageError(f"{name!r} is a word of Python", "choose another name; for example wind_gusts")
    if not _NAME.fullmatch(short) or len(short) > _MOST:
        raise UsageError(
            f"{name!r} is no name for a plugin",
            f"small letters, digits, '-' and '_' between them, at most {_MOST}; for example wind_gusts",
        )
    taken = short.replace("-", "_")
    owner = FIRST_PARTY.get((kind, taken)) or next(
        (row.distribution for row in registry.rows() if (row.kind, row.name) == (kind, taken)), None
    )
    if owner is not None:
        raise UsageError(f"the {kind} {taken!r} exists: it is provided by {owner}", "choose another name")
    return taken


def write(name: str, kind: str, folder: Path) -> Path:
    """Write the package ``avrare-NAME`` into a folder.

    Args:
        name: As ``check_name`` returns it.
        kind: One of ``KINDS``.
        folder: Where the new folder is made.

    Returns:
        The new folder.

    Raises:
        UsageError: It is there already, or cannot be written.
    """
    words = _words(name, kind)
    target = folder / words["distribution"]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.mkdir()
        for path, text in _files(words).items():
            (target / path).parent.mkdir(parents=True, exist_ok=True)
            (target / path).write_text(text, encoding="utf-8")
    except FileExistsError as error:
        raise UsageError(f"{error.filename}: is there already", "choose another name or --out") from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UsageError(f"{error.filename or target}: cannot be written: {reason}") from None
    return target


def _words(name: str, kind: str) -> dict[str, str]:
    """What the templates are filled with."""
    words = {
        "name": name,
        "Name": "".join(part.capitalize() for part in name.split("_")),
        "kind": kind,
        "Article": "An" if kind[0] in "aeiou" else "A",
        "distribution": "avrare-" + name.replace("_", "-"),
        "package": f"avrare_{name}",
        "module": kind,
        "summary": _SUMMARIES[kind],
        "extras": "\n            driving=True," if kind in _DRIVING else "",
        "test_header": _HEADERS.get(kind, "import numpy as np\n"),
        "test_footer": _SUITE if kind == "estimator" else "",
    }
    for part in ("test", "example"):
        words[part] = _filled(f"{part}_{kind}.txt", words).rstrip("\n")
    return {**words, "options": _filled(f"config_{kind}.txt", words).rstrip("\n")}


def _files(words: Mapping[str, str]) -> dict[str, str]:
    source, kind = f"src/{words['package']}", words["kind"]
    templates = {
        "pyproject.toml": "pyproject.toml.txt",
        "README.md": "README.md.txt",
        f"{source}/__init__.py": "init.py.txt",
        f"{source}/config.py": "config.py.txt",
        f"{source}/{kind}.py": f"part_{kind}.txt",
        f"tests/test_{words['package']}.py": "test.py.txt",
    }
    return {**{path: _filled(file, words) for path, file in templates.items()}, f"{source}/py.typed": ""}


def _filled(file: str, words: Mapping[str, str]) -> str:
    return Template((_TEMPLATES / file).read_text(encoding="utf-8")).substitute(words)
