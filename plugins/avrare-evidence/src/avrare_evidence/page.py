"""case.md: the argument as a graph and tables, for people."""

from __future__ import annotations

import json
import shlex
import textwrap
from collections.abc import Mapping, Sequence
from itertools import count

from jinja2 import Environment, PackageLoader, StrictUndefined

from avrare.base.number_format import format_interval, format_probability
from avrare_evidence.claims import Statement
from avrare_evidence.gsn import Case, find_kind
from avrare_evidence.manifest import PackedRun
from avrare_evidence.sheets import Sheet

PAGE = "case.md"
_GRAPH_CHARACTERS, _TABLE_CHARACTERS = 110, 440
"""Characters of a text, after which the graph and the tables cut it; ``case.gsn.yaml`` has the whole."""


def write_page(
    name: str,
    statements: Sequence[Statement],
    sheets: Mapping[str, Sheet],
    case: Case,
    runs: Sequence[PackedRun],
) -> str:
    """Return the page as Markdown."""

    def group(*keys: str) -> list[tuple[str, ...]]:
        """List the entries of a part of each sheet, each once with the test cases that it is common to."""
        cases: dict[tuple[str, ...], list[str]] = {}
        for path, sheet in sheets.items():
            content = sheet
            for key in keys:
                content = content[key]
            entries = content.items() if isinstance(content, dict) else ((entry, None) for entry in content)
            for entry, value in entries:
                row = (entry,) if value is None else (entry, _describe(value))
                cases.setdefault(row, []).append(path.removeprefix("test-cases/").removesuffix(".yaml"))
        return [
            (*row, "all" if len(names) == len(sheets) else ", ".join(names)) for row, names in cases.items()
        ]

    seeds = [run.seed for run in runs]
    environment = Environment(
        loader=PackageLoader("avrare_evidence", ""),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"probability": format_probability, "interval": format_interval, "kind": find_kind}
    environment.filters |= {
        "describe": _describe,
        "mermaid": _escape,
        "cell": lambda text: text.replace("|", "\\|"),
    }
    return environment.get_template("case.md.jinja").render(
        name=name,
        claims=[statement for statement in statements if statement.measure is not None],
        statements=statements,
        sheets=sheets,
        case=case,
        runs=runs,
        commands=[_tell_command(run) for run in runs],
        group=group,
        seed=next(seed for seed in count(1) if seed not in seeds),
    )


def _tell_command(run: PackedRun) -> str:
    """Return the command that repeats a run in the folder of its scenario."""
    budget = ["--budget", run.budget] if run.budget else []
    scenario = run.scenario.removeprefix("repeat/")
    return shlex.join(["avrare", "run", scenario, *budget, "--out", f"../../repeated/{run.name}"])


def _describe(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False).replace('"', "")
    return f"`{textwrap.shorten(text, _TABLE_CHARACTERS, placeholder=' ...')}`"


def _escape(text: str) -> str:
    """Return a short form of a text that Mermaid shows as it is."""
    short = textwrap.shorten(text, _GRAPH_CHARACTERS, placeholder=" ...")
    return "".join(f"#{ord(character)};" if character in '"<>`#;&' else character for character in short)
