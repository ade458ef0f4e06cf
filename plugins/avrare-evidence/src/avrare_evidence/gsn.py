"""Goal structuring notation (GSN v3) in the YAML syntax of gsn2x, and the rules that hold for it.

Counter goals and counter solutions, which challenge other elements, are those of its dialectic extension.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any

from pydantic import BaseModel, ConfigDict
from pydantic.alias_generators import to_camel

from avrare_evidence.claims import Statement

_SUPPORTS = {"G": "G S Sn", "S": "G S Sn", "CG": "CG G S Sn CSn"}
"""Kind of an element -> kinds that support it."""
_KINDS = (*_SUPPORTS, "Sn", "CSn", "C", "A", "J")


class Element(BaseModel):
    """Element of an argument; further keys are layers for programs."""

    model_config = ConfigDict(strict=True, extra="allow", alias_generator=to_camel, populate_by_name=True)

    text: str
    supported_by: list[str] = []
    in_context_of: list[str] = []
    challenges: str | None = None
    undeveloped: bool = False
    defeated: bool = False
    url: str = ""
    sha256: str = ""

    @property
    def links(self) -> list[tuple[str, str]]:
        """References: relation and id."""
        targets = {"supportedBy": self.supported_by, "inContextOf": self.in_context_of}
        pairs = [(relation, target) for relation, names in targets.items() for target in names]
        return pairs + ([("challenges", self.challenges)] if self.challenges else [])


Case = dict[str, Element]
"""Elements by id."""


def build_case(name: str, sources: Mapping[str, Iterable[Statement]], digests: Mapping[str, str]) -> Case:
    """Return the argument: one goal above all, a strategy for each source, and a goal for each claim.

    Args:
        name: Name of the pack.
        sources: Premises and claims by source.
        digests: SHA-256 of the files that support claims, by path.
    """
    case: Case = {}

    def add(kind: str, text: str, **fields: Any) -> str:
        key = f"{kind}{1 + sum(find_kind(other) == kind for other in case)}"
        case[key] = Element(text=text, **fields)
        return key

    def challenge(target: str, statement: Statement) -> None:
        for doubt in statement.challenges:
            evidence = [add("CSn", doubt.url.partition("#")[2], url=doubt.url)] if doubt.url else []
            support = {"supported_by": evidence, "undeveloped": not evidence}
            counter = add("CG", doubt.text, challenges=target, **support)
            if doubt.answer:
                add("CG", doubt.answer, challenges=counter, undeveloped=True)
                case[counter].defeated = not doubt.decides

    top = add("G", f"The stack keeps the rules of {name} as often as claimed")
    for source, statements in sources.items():
        text = f"{source}: estimate how often each rule is broken; a verdict needs the whole interval"
        strategy, solutions = add("S", text), dict[str, str]()
        case[top].supported_by.append(strategy)
        for statement in statements:
            key = add(statement.kind, statement.text, defeated=statement.is_defeated, **statement.layers)
            if file := statement.file:
                if file not in solutions:
                    solutions[file] = add(
                        "Sn", file.removeprefix("evidence/"), url=file, sha256=digests[file]
                    )
                case[key].supported_by.append(solutions[file])
                case[strategy].supported_by.append(key)
            else:
                case[strategy].in_context_of.append(key)
            challenge(key, statement)
    return case


def dump_case(name: str, case: Case, versions: Mapping[str, str]) -> dict[str, object]:
    """Return the content of case.gsn.yaml."""
    module = {"name": name, "brief": "Argument from simulated drives", "extra": dict(versions)}
    elements = {
        key: element.model_dump(by_alias=True, exclude_defaults=True) for key, element in case.items()
    }
    return {"module": module, **elements}


def find_kind(key: str) -> str:
    """Return the letters of an element's id, which give its kind; empty for other keys."""
    match = re.fullmatch(r"([A-Z][A-Za-z]?[a-z]?)\d+", key)
    return match[1] if match and match[1] in _KINDS else ""


def find_faults(case: Case) -> list[str]:
    """Return a line for each rule of gsn2x that a case breaks, with the rule's number."""
    faults = [fault for key, element in case.items() for fault in _check_element(key, element, case)]
    targets = {target for element in case.values() for _, target in element.links}
    tops = [key for key in case if key not in targets and find_kind(key) not in ("CG", "CSn")]
    if [find_kind(key) for key in tops] != ["G"]:
        faults.append(f"C01 one goal should stand above all, not {', '.join(tops) or 'none'}")
    try:
        TopologicalSorter({key: element.supported_by for key, element in case.items()}).prepare()
    except CycleError as error:
        faults.append(f"C04 {' -> '.join(error.args[1])}: the support leads in a circle")
    return faults


def _check_element(key: str, element: Element, case: Case) -> Iterator[str]:
    kind, targets = find_kind(key), [target for _, target in element.links]
    allowed = {"supportedBy": _SUPPORTS.get(kind, "").split(), "inContextOf": ["C", "A", "J"]}
    is_challenged = any(other.challenges == key for other in case.values())
    is_incomplete = kind in _SUPPORTS and bool(element.supported_by) == element.undeveloped
    rules = {
        f"V01 {key}: its id begins with none of {', '.join(_KINDS)}": not kind,
        f"V02 {key}: it needs either support or `undeveloped: true`": is_incomplete,
        f"V05 {key}: it refers twice to the same element": len(set(targets)) < len(targets),
        f"V06 {key}: it refers to itself": key in targets,
        f"V10 {key}: it is marked as defeated, but nothing challenges it": element.defeated
        and not is_challenged,
        f"V12 {key}: only counter goals and counter solutions challenge": bool(element.challenges)
        and kind not in ("CG", "CSn"),
    }
    yield from (fault for fault, is_broken in rules.items() if is_broken)
    for relation, target in element.links:
        if target not in case:
            yield f"C03 {key}: {relation} refers to {target}, which is missing"
        elif find_kind(target) not in allowed.get(relation, _KINDS):
            yield f"V04 {key}: {relation} cannot refer to {target}"
