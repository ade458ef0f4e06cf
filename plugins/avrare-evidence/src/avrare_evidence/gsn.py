"""Goal structuring notation (GSN v3) in the YAML syntax of gsn2x, and the rules that hold for it.

Counter goals and counter solutions, which challenge other elements, are those of its dialectic extension.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any

from pydantic import BaseModel, ConfigDict
from pydantic.alias_generators import to_camel

_KINDS = {"G": "G S Sn", "S": "G S Sn", "CG": "CG G S Sn CSn"} | dict.fromkeys(
    ["Sn", "CSn", "C", "A", "J"], ""
)
"""Kind of an element -> kinds that support it."""
STATES = {
    "pass": "holds",
    "pass_assuming": "holds as far as the search could see",
    "inconclusive": "not shown",
    "fail": "refuted",
    None: "measured, no bound asked",
}
"""Verdict -> state of a claim."""


@dataclass(frozen=True)
class Measure:
    """Numbers of a claim; ``bound`` and ``verdict`` are None where no bound is set."""

    rule: str
    value: float | None
    low: float
    high: float
    bound: str | None
    verdict: str | None
    unit: str
    blind: float | None


class Element(BaseModel):
    """Element of an argument; further keys are layers for programs."""

    model_config = ConfigDict(extra="allow", alias_generator=to_camel, populate_by_name=True)

    text: str
    supported_by: list[str] = []
    in_context_of: list[str] = []
    challenges: str | None = None
    undeveloped: bool = False
    defeated: bool = False
    decides: bool = False
    url: str = ""
    sha256: str = ""
    measure: Measure | None = None

    @property
    def links(self) -> list[tuple[str, str]]:
        """References: relation and id."""
        targets = {"supportedBy": self.supported_by, "inContextOf": self.in_context_of}
        pairs = [(relation, target) for relation, names in targets.items() for target in names]
        return pairs + ([("challenges", self.challenges)] if self.challenges else [])


Case = dict[str, Element]
"""Elements by id."""


def add_element(case: Case, kind: str, text: str, **fields: Any) -> str:
    """Add an element and return its id, the letters of its kind and a number."""
    key = f"{kind}{1 + sum(find_kind(other) == kind for other in case)}"
    case[key] = Element(text=text, **fields)
    return key


def add_challenge(
    case: Case, target: str, text: str, url: str = "", decides: bool = False, answer: str = ""
) -> None:
    """Add a reason to doubt an element, with its answer; a reason that ``decides`` defeats the element.

    ``url`` is the file of the pack with the evidence, and the key in it behind ``#``.
    """
    evidence = [add_element(case, "CSn", url.partition("#")[2], url=url)] if url else []
    fields = {"supported_by": evidence, "undeveloped": not evidence, "decides": decides}
    counter = add_element(case, "CG", text, challenges=target, **fields)
    case[target].defeated |= decides
    if answer:
        add_element(case, "CG", answer, challenges=counter, undeveloped=True)
        case[counter].defeated = not decides


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
    supports, is_counter = _KINDS.get(kind, "").split(), kind in ("CG", "CSn")
    is_challenged = any(other.challenges == key for other in case.values())
    broken = {
        f"V01 {key}: its id begins with none of {', '.join(_KINDS)}": not kind,
        f"V02 {key}: it needs either support or `undeveloped: true`": supports
        and bool(element.supported_by) == element.undeveloped,
        f"V05 {key}: it refers twice to the same element": len(set(targets)) < len(targets),
        f"V06 {key}: it refers to itself": key in targets,
        f"V10 {key}: it is marked as defeated, but nothing challenges it": element.defeated > is_challenged,
        f"V12 {key}: only counter goals and counter solutions challenge": bool(element.challenges)
        > is_counter,
    }
    yield from (rule for rule, is_broken in broken.items() if is_broken)
    allowed = {"supportedBy": supports, "inContextOf": ["C", "A", "J"], "challenges": list(_KINDS)}
    for relation, target in element.links:
        if target not in case:
            yield f"C03 {key}: {relation} refers to {target}, which is missing"
        elif find_kind(target) not in allowed[relation]:
            yield f"V04 {key}: {relation} cannot refer to {target}"
