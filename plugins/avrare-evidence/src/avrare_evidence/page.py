"""case.md: the argument as a graph and tables, for people."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from avrare.base.number_format import format_interval, format_probability
from avrare_evidence.claims import Claim
from avrare_evidence.gsn import Case, find_prefix, list_links
from avrare_evidence.sheets import Sheet

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
_TEMPLATE = Path(__file__).parent / "case.md.template"


def write_page(
    case: Case, claims: Sequence[Claim], sheets: Mapping[str, Sheet], commands: Sequence[str], seed: int
) -> str:
    """Return the page as Markdown; ``commands`` repeat the runs, and ``seed`` is that of none."""
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=case["module"]["name"],
        summary=_summarise(claims),
        claims=_table("Claim | Estimate | Interval | State | Rests on", map(_list_cells, claims)),
        challenges="\n\n".join([*_list_challenges(claims), *_list_doubts(case)]) or "Nothing on record.",
        commands="\n".join(commands),
        seed=seed,
        graph=draw_graph(case),
        cases=_table("Test case | Objective | Broken drives of all", map(_list_case_cells, sheets.items())),
        tags=_group("Requirement or ODD", sheets, lambda x: dict.fromkeys(x["requirements"] + x["odd"])),
        stack=_group("Component | Plugin", sheets, lambda x: x["inputs"]["stack"]),
        rules=_group("Rule | Definition", sheets, lambda x: x["inputs"]["rules"]),
        laws=_group("Drawn option | Law", sheets, lambda x: x["inputs"]["laws"]),
        models=_group("Option | File", sheets, lambda x: x["inputs"]["files"] | x["inputs"]["models"]),
        exposures=_table("Scene | Times | Interval | Stated as", _list_exposures(case, sheets)),
        platform=_group("Platform | Of the runs", sheets, lambda x: x["platform"]),
    )


def _summarise(claims: Sequence[Claim]) -> str:
    states = [claim.state for claim in claims]
    counts = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
    doubts = sum(len(claim.challenges) for claim in claims)
    defeated = sum(claim.is_defeated for claim in claims)
    return f"Claims: {counts}. Reasons for doubt on record: {doubts}; claims that one defeats: {defeated}."


def _list_cells(claim: Claim) -> tuple[str, ...]:
    measure, source = claim.measure, f"[{claim.file.removeprefix('evidence/')}]({claim.file})"
    value = "not known" if measure["value"] is None else format_probability(measure["value"])
    interval = format_interval((measure["low"], measure["high"]))
    return claim.text, f"{value} {measure['unit']}".rstrip(), interval, f"**{claim.state}**", source


def _list_challenges(claims: Sequence[Claim]) -> Iterator[str]:
    for claim in (claim for claim in claims if claim.challenges):
        yield f"{claim.text}:"
        yield "\n".join(
            f"- {'**decides the verdict**: ' * challenge.decides}{challenge.text}"
            f"{f'. Against this: {challenge.answer}' if challenge.answer else ''}"
            f" (`{challenge.place}` of [{claim.file}]({claim.file}))"
            for challenge in claim.challenges
        )


def _list_doubts(case: Case) -> Iterator[str]:
    doubts = [
        element for element in case.values() if find_prefix(str(element.get("challenges"))) in ("C", "A")
    ]
    for target in dict.fromkeys(element["challenges"] for element in doubts):
        yield f"{case[target]['text']} ({target}):"
        yield "\n".join(f"- {element['text']}" for element in doubts if element["challenges"] == target)


def _list_case_cells(entry: tuple[str, Sheet]) -> tuple[str, ...]:
    path, sheet = entry
    counts = (
        f"{rule}: {x['failures']:,} of {x['rollouts']:,}" for rule, x in sheet["actual"]["estimates"].items()
    )
    return f"[{_name(path)}]({path})", sheet["objective"] or "", "<br>".join(counts)


def _list_exposures(case: Case, sheets: Mapping[str, Sheet]) -> Iterator[tuple[str, ...]]:
    stated = {sheet["scenario"]["name"]: sheet["scenario"]["exposure"] for sheet in sheets.values()}
    for element in case.values():
        for name, met in element.get("exposures", {}).items():
            times = f"{format_probability(met['value'])} per {met['unit']}"
            yield name, times, format_interval((met["low"], met["high"])), _describe(stated.get(name))


def _group(head: str, sheets: Mapping[str, Sheet], select: Callable[[Sheet], Mapping[str, Any]]) -> str:
    """Return a table of a part of each sheet: what is common to several stands once."""
    cases: dict[tuple[str, ...], list[str]] = {}
    for path, sheet in sheets.items():
        for key, value in select(sheet).items():
            row = (key,) if value is None else (key, _describe(value))
            cases.setdefault(row, []).append(_name(path))
    rows = ((*row, "all" if len(names) == len(sheets) else ", ".join(names)) for row, names in cases.items())
    return _table(f"{head} | Test cases", rows)


def _name(path: str) -> str:
    return path.removeprefix("test-cases/").removesuffix(".yaml")


def _describe(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False).replace('"', "")
    return f"`{textwrap.shorten(text, 4 * _MAX_CHARACTERS, placeholder=' ...')}`"


def _table(head: str, rows: Iterable[Sequence[str]]) -> str:
    titles = head.split(" | ")
    lines = [titles, ["---"] * len(titles), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) if len(lines) > 2 else "None."


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
