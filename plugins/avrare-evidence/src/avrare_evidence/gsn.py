"""Goal structuring notation (GSN v3) in the YAML syntax of gsn2x, and the rules that hold for it.

Counter goals and counter solutions, which challenge other elements, are those of its dialectic extension.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from avrare_evidence.claims import Claim
from avrare_evidence.sources import Source, list_laws

Case = dict[str, dict[str, Any]]
"""Elements by id; the entry ``module`` describes the case."""

_SUPPORTS = {"G": ("G", "S", "Sn"), "S": ("G", "S", "Sn"), "CG": ("CG", "G", "S", "Sn", "CSn")}
_PREFIXES = (*_SUPPORTS, "Sn", "CSn", "C", "A", "J")


def build_case(sources: Sequence[Source], claims: Sequence[Claim], digests: Mapping[str, str]) -> Case:
    """Return the argument: one goal above all, a strategy for each source, and a goal for each claim.

    Args:
        sources: Sources of the pack.
        claims: Their claims.
        digests: SHA-256 of the files of the pack, by path.
    """
    names = ", ".join(source.name for source in sources)
    versions = {key: text for s in sources for run in s.runs.values() for key, text in run.versions.items()}
    case: Case = {
        "module": {
            "name": names,
            "brief": "Argument from simulated drives",
            "extra": dict(sorted(versions.items())),
        }
    }
    top = _add(case, "G", text=f"The stack keeps the rules of {names} as often as claimed", supportedBy=[])
    for source in sources:
        text = f"{source.name}: estimate how often each rule is broken; a verdict needs the whole interval"
        contexts = list(_add_contexts(case, source, digests))
        strategy = _add(case, "S", text=text, inContextOf=contexts, supportedBy=[])
        case[top]["supportedBy"].append(strategy)
        solutions: dict[str, str] = {}
        for claim in (claim for claim in claims if claim.source is source):
            if claim.file not in solutions:
                solutions[claim.file] = _add_solution(case, claim, digests)
            goal = _add(
                case, "G", text=claim.text, supportedBy=[solutions[claim.file]], measure=dict(claim.measure)
            )
            case[strategy]["supportedBy"].append(goal)
            _add_challenges(case, goal, claim)
    return case


def _add(case: Case, prefix: str, **element: object) -> str:
    key = f"{prefix}{1 + sum(find_prefix(other) == prefix for other in case)}"
    case[key] = element
    return key


def find_prefix(key: str) -> str:
    """Return the letters of an element's id, which give its kind; empty for other keys."""
    match = re.fullmatch(r"([A-Z][A-Za-z]?[a-z]?)\d+", key)
    return match[1] if match and match[1] in _PREFIXES else ""


def _add_solution(case: Case, claim: Claim, digests: Mapping[str, str]) -> str:
    run = next(iter(claim.source.runs.values()))
    return _add(
        case,
        "Sn",
        text=claim.file.removeprefix("evidence/"),
        url=claim.file,
        sha256=digests[claim.file],
        seed=claim.source.summary.get("seed", run.seed),
        command=" ".join(["avrare", *run.provenance.command[1:]]),
    )


def _add_contexts(case: Case, source: Source, digests: Mapping[str, str]) -> Iterator[str]:
    """Add the scenarios with their tags, and the assumptions: laws of drawn options, and exposures."""
    scenarios: dict[str, object] = {}
    laws: dict[str, object] = {}
    doubts: list[str] = []
    for place, run in source.runs.items():
        file, scenario = f"{source.home}{place}scenario.yaml", run.definition
        assert scenario is not None
        scenarios[run.name] = {
            "description": scenario.description,
            "file": file,
            "sha256": digests[file],
            "requirements": list(scenario.requirements),
            "odd": list(scenario.odd),
            "objective": scenario.objective,
        }
        laws |= {run.name: drawn} if (drawn := list_laws(scenario)) else {}
        doubts += [message.partition(": ")[2] or message for message, _ in scenario.warnings]
    context = _add(case, "C", text=f"Scenarios: {', '.join(scenarios)}", scenarios=scenarios)
    yield context
    for text in dict.fromkeys(doubts):
        _add(case, "CG", text=text, challenges=context, undeveloped=True)
    if laws:
        yield _add(case, "A", text=f"{source.name}: starts follow the laws of the drawn options", laws=laws)
    if "scenes" in source.summary:
        exposures = {
            scene["name"]: {**scene["exposure"], "unit": scene["unit"]} for scene in source.summary["scenes"]
        }
        yield _add(case, "A", text=f"{source.name}: scenes are met as often as stated", exposures=exposures)


def _add_challenges(case: Case, goal: str, claim: Claim) -> None:
    if claim.is_defeated:
        case[goal]["defeated"] = True
    for challenge in claim.challenges:
        evidence = _add(case, "CSn", text=challenge.place, url=f"{claim.file}#{challenge.place}")
        counter = _add(case, "CG", text=challenge.text, challenges=goal, supportedBy=[evidence])
        if challenge.answer:
            _add(case, "CG", text=challenge.answer, challenges=counter, undeveloped=True)
            case[counter]["defeated"] = not challenge.decides


def list_links(element: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the references of an element: relation and id."""
    targets = {
        relation: element.get(relation, ()) for relation in ("supportedBy", "inContextOf", "challenges")
    }
    return [
        (relation, str(target))
        for relation, names in targets.items()
        for target in ([names] if isinstance(names, str) else names)
    ]


def find_faults(case: Mapping[str, Any]) -> list[str]:
    """Return a line for each rule of gsn2x that a case breaks, with the rule's number."""
    elements = {key: element for key, element in case.items() if key != "module"}
    broken = [
        key for key, element in elements.items() if not isinstance(element, dict) or "text" not in element
    ]
    if broken:
        return [f"V01 {key}: it has no text" for key in broken]
    links = {key: list_links(element) for key, element in elements.items()}
    faults = [
        f"{fault}" for key, element in elements.items() for fault in _find_element_faults(key, element, links)
    ]
    referred = {target for pairs in links.values() for _, target in pairs}
    tops = [key for key in elements if key not in referred and find_prefix(key) not in ("CG", "CSn")]
    if len(tops) != 1 or find_prefix(tops[0]) != "G":
        faults.append(f"C01 one goal should stand above all, not {', '.join(tops) or 'none'}")
    return faults + [f"C04 {key}: it supports itself" for key in elements if _is_circular(key, links)]


def _find_element_faults(
    key: str, element: Mapping[str, Any], links: Mapping[str, Sequence[tuple[str, str]]]
) -> Iterator[str]:
    prefix = find_prefix(key)
    if not prefix:
        yield f"V01 {key}: its id begins with none of {', '.join(_PREFIXES)}"
    if prefix in _SUPPORTS and bool(element.get("supportedBy")) == bool(element.get("undeveloped")):
        yield f"V02 {key}: it needs either support or `undeveloped: true`"
    if len(set(links[key])) < len(links[key]):
        yield f"V05 {key}: it refers twice to the same element"
    if element.get("defeated") and not any(("challenges", key) in pairs for pairs in links.values()):
        yield f"V10 {key}: it is marked as defeated, but nothing challenges it"
    allowed = {
        "supportedBy": _SUPPORTS.get(prefix, ()),
        "inContextOf": ("C", "A", "J"),
        "challenges": _PREFIXES,
    }
    for relation, target in links[key]:
        if target == key:
            yield f"V06 {key}: it refers to itself"
        elif target not in links:
            yield f"C03 {key}: {relation} refers to {target}, which is missing"
        elif find_prefix(target) not in allowed[relation]:
            yield f"V04 {key}: {relation} cannot refer to {target}"
        elif relation == "challenges" and prefix not in ("CG", "CSn"):
            yield f"V12 {key}: only counter goals and counter solutions challenge"


def _is_circular(key: str, links: Mapping[str, Sequence[tuple[str, str]]]) -> bool:
    reached: set[str] = set()
    ahead = [key]
    while ahead:
        targets = [target for relation, target in links.get(ahead.pop(), ()) if relation == "supportedBy"]
        ahead += [target for target in targets if target not in reached]
        reached.update(targets)
    return key in reached
