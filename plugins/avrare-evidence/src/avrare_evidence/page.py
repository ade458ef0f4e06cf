"""case.md: the argument as a graph and tables, for people."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from functools import reduce

from jinja2 import Environment, PackageLoader, StrictUndefined

from avrare.base.number_format import format_interval, format_probability
from avrare_evidence.argument import Sheet
from avrare_evidence.gsn import STATES, Case, find_kind

_GRAPH_CHARACTERS, _TABLE_CHARACTERS = 110, 440
"""Characters of a text, after which the graph and the tables cut it; ``case.gsn.yaml`` has the whole."""


def write_page(name: str, case: Case, sheets: Mapping[str, Sheet]) -> str:
    """Return the page of a pack, of its argument and the sheets of its test cases by path, as Markdown."""
    environment = Environment(
        loader=PackageLoader("avrare_evidence", ""),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "probability": format_probability,
        "interval": format_interval,
        "kind": find_kind,
        "describe": _describe,
        "mermaid": _escape,
        "cell": lambda text: text.replace("|", "\\|"),
        "group": lambda path: _group(sheets, path.split(".")),
    }
    template = environment.get_template("case.md.jinja")
    return template.render(name=name, case=case, states=STATES, sheets=sheets)


def _group(sheets: Mapping[str, Sheet], keys: Sequence[str]) -> list[tuple[str, ...]]:
    """List the entries of a part of each sheet, each once with the test cases that it is common to."""
    cases: dict[tuple[str, ...], list[str]] = {}
    for path, sheet in sheets.items():
        content = reduce(lambda part, key: part[key], keys, sheet)
        for entry in content:
            row = (entry, _describe(content[entry])) if isinstance(content, dict) else (entry,)
            cases.setdefault(row, []).append(path[len("test-cases/") : -len(".yaml")])
    return [(*row, "all" if len(names) == len(sheets) else ", ".join(names)) for row, names in cases.items()]


def _describe(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False).replace('"', "")
    return f"`{textwrap.shorten(text, _TABLE_CHARACTERS, placeholder=' ...')}`"


def _escape(text: str) -> str:
    """Return a short form of a text that Mermaid shows as it is."""
    short = textwrap.shorten(text, _GRAPH_CHARACTERS, placeholder=" ...")
    return "".join(f"#{ord(character)};" if character in '"<>`#;&' else character for character in short)
