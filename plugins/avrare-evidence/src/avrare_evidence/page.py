"""case.md: the argument as a graph and tables, for people."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import yaml

from avrare.base.number_format import format_interval, format_probability
from avrare_evidence.claims import Claim
from avrare_evidence.gsn import Case, find_prefix, list_links
from avrare_evidence.sources import Source

_SHAPES = {
    "CSn": ("((", "))", "counter"),
    "CG": ("[", "]", "counter"),
    "Sn": ("((", "))", "solution"),
    "G": ("[", "]", "goal"),
    "S": ("[/", "/]", "strategy"),
    "C": ("([", "])", "context"),
    "A": ("([", "])", "context"),
}
"""Prefix of an id -> Mermaid's brackets, and the class that colours it."""
_ARROWS = {"supportedBy": "-->", "inContextOf": "-.->", "challenges": "-. challenges .->"}
_MAX_CHARACTERS = 110
"""Characters of an element's text in the graph; tables have the whole text."""


def write_page(case: Case, sources: Sequence[Source], claims: Sequence[Claim], sheets: Sequence[str]) -> str:
    """Return the page as Markdown."""
    seeds = [run.seed for source in sources for run in source.runs.values()]
    return Template((Path(__file__).parent / "case.md.template").read_text(encoding="utf-8")).substitute(
        name=case["module"]["name"],
        summary=_summarise(claims),
        claims=_table(("Claim", "Estimate", "Interval", "State", "Rests on"), map(_list_cells, claims)),
        challenges="\n\n".join(_list_challenges(claims)) or "Nothing on record.",
        commands="\n".join(_list_commands(sources)),
        seed=next(seed for seed in range(1, len(seeds) + 2) if seed not in seeds),
        graph=draw_graph(case),
        assumptions="\n\n".join(_list_assumptions(case)),
        sheets="\n".join(f"- [{sheet}]({sheet})" for sheet in sheets),
        versions=", ".join(f"{key} {text}" for key, text in case["module"]["extra"].items()),
    )


def _summarise(claims: Sequence[Claim]) -> str:
    states = [claim.state for claim in claims]
    counts = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
    doubts, defeated = (
        sum(len(claim.challenges) for claim in claims),
        sum(claim.is_defeated for claim in claims),
    )
    return f"Claims: {counts}. Reasons for doubt on record: {doubts}; claims that one defeats: {defeated}."


def _list_cells(claim: Claim) -> tuple[str, ...]:
    measure, source = claim.measure, f"[{claim.file.removeprefix('evidence/')}]({claim.file})"
    value = format_probability(measure["value"]) + f" {measure.get('unit', '')}".rstrip()
    return claim.text, value, format_interval((measure["low"], measure["high"])), f"**{claim.state}**", source


def _list_challenges(claims: Sequence[Claim]) -> Iterator[str]:
    for claim in claims:
        lines = []
        for challenge in claim.challenges:
            decides = "**decides the verdict**: " if challenge.decides else ""
            answer = f". Against this: {challenge.answer}" if challenge.answer else ""
            lines.append(
                f"- {decides}{challenge.text}{answer} (`{challenge.place}` of [{claim.file}]({claim.file}))"
            )
        if lines:
            yield f"{claim.text}:"
            yield "\n".join(lines)


def _list_commands(sources: Sequence[Source]) -> Iterator[str]:
    for source in sources:
        for place, run in source.runs.items():
            budget = f" --budget {run.provenance.budget}" if run.provenance.budget else ""
            yield f"avrare run {source.home}{place}scenario.yaml{budget}"


def _list_assumptions(case: Case) -> Iterator[str]:
    for key, element in case.items():
        if "laws" in element:
            rows = (
                (name, f"`{option}`", _describe_law(law))
                for name, laws in element["laws"].items()
                for option, law in laws.items()
            )
            yield f"**{key}** {element['text']}:"
            yield _table(("Scenario", "Option", "Law"), rows)
        elif "exposures" in element:
            yield f"**{key}** {element['text']}:"
            met = element["exposures"].items()
            rows = (
                (
                    name,
                    f"{format_probability(x['value'])} per {x['unit']}",
                    format_interval((x["low"], x["high"])),
                )
                for name, x in met
            )
            yield _table(("Scene", "Times", "Interval"), rows)


def _describe_law(law: Mapping[str, Any]) -> str:
    text = yaml.safe_dump(dict(law), default_flow_style=True, sort_keys=False, width=10_000).strip()
    return f"`{textwrap.shorten(text, _MAX_CHARACTERS, placeholder=' ...')}`"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def draw_graph(case: Case) -> str:
    """Return the argument as a Mermaid flow chart."""
    lines, links = ["flowchart TD"], []
    for key, element in case.items():
        if key != "module":
            begin, end, style = _SHAPES[find_prefix(key)]
            style = "defeated" if element.get("defeated") else style
            lines.append(f'  {key}{begin}"<b>{key}</b><br>{_escape(element["text"])}"{end}:::{style}')
            links += [f"  {key} {_ARROWS[relation]} {target}" for relation, target in list_links(element)]
    return "\n".join([*lines, *links])


def _escape(text: str) -> str:
    short = textwrap.shorten(text, _MAX_CHARACTERS, placeholder=" ...")
    return "".join(f"#{ord(character)};" if character in '"<>`#;&' else character for character in short)
