"""Goal structuring notation (GSN v3) in the YAML syntax of gsn2x, and the rules that hold for it.

Counter goals and counter solutions, which challenge other elements, are those of its dialectic extension.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import mean, variance
from typing import Any

from avrare.results.run import Run
from avrare_evidence.claims import Claim
from avrare_evidence.sheets import Sheet
from avrare_evidence.sources import Source

Case = dict[str, dict[str, Any]]
"""Elements by id; the entry ``module`` describes the case."""

Links = Mapping[str, Sequence[tuple[str, str]]]
"""References of each element: relation and id."""

_SUPPORTS = {"G": ("G", "S", "Sn"), "S": ("G", "S", "Sn"), "CG": ("CG", "G", "S", "Sn", "CSn")}
_PREFIXES = (*_SUPPORTS, "Sn", "CSn", "C", "A", "J")


def build_case(
    sources: Sequence[Source],
    claims: Sequence[Claim],
    sheets: Mapping[str, Sheet],
    digests: Mapping[str, str],
) -> Case:
    """Return the argument: one goal above all, a strategy for each source, and a goal for each claim.

    Args:
        sources: Sources of the pack.
        claims: Their claims.
        sheets: Sheets of their test cases, by path.
        digests: SHA-256 of the files of the pack, by path.
    """
    names = ", ".join(source.name for source in sources)
    versions = {key: text for sheet in sheets.values() for key, text in sheet["platform"]["versions"].items()}
    module = {
        "name": names,
        "brief": "Argument from simulated drives",
        "extra": dict(sorted(versions.items())),
    }
    case: Case = {"module": module}
    top = _add(case, "G", text=f"The stack keeps the rules of {names} as often as claimed", supportedBy=[])
    for source in sources:
        text = f"{source.name}: estimate how often each rule is broken; a verdict needs the whole interval"
        cases = {path: sheet for path, sheet in sheets.items() if sheet["source"] == source.name}
        contexts = list(_add_contexts(case, source, cases, digests))
        strategy = _add(case, "S", text=text, inContextOf=contexts, supportedBy=[])
        case[top]["supportedBy"].append(strategy)
        solutions: dict[str, str] = {}
        for claim in (claim for claim in claims if claim.source is source):
            if claim.file not in solutions:
                solutions[claim.file] = _add_solution(case, claim, digests)
            goal = _add(
                case, "G", text=claim.text, supportedBy=[solutions[claim.file]], measure=claim.measure
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


def _add_contexts(
    case: Case, source: Source, sheets: Mapping[str, Sheet], digests: Mapping[str, str]
) -> Iterator[str]:
    """Add the scenarios with their tags, and the assumptions: laws of drawn options, and exposures."""
    tags, names = (
        ("objective", "requirements", "odd"),
        [sheet["scenario"]["name"] for sheet in sheets.values()],
    )
    files = {path: sheet["scenario"]["file"] for path, sheet in sheets.items()}
    scenarios = {
        path: {"file": files[path], "sha256": digests[files[path]], **{tag: sheet[tag] for tag in tags}}
        for path, sheet in sheets.items()
    }
    context = _add(case, "C", text=f"Scenarios: {', '.join(dict.fromkeys(names))}", scenarios=scenarios)
    yield context
    doubts = [doubt for run in source.runs.values() for doubt in _list_run_doubts(run)]
    rows = source.summary.get("rows", ())
    _add_doubts(case, context, [*doubts, *(x["reason"] for x in rows if x["question"] == "baseline")])
    if laws := {path: sheet["inputs"]["laws"] for path, sheet in sheets.items() if sheet["inputs"]["laws"]}:
        yield _add(case, "A", text=f"{source.name}: starts follow the laws of the drawn options", laws=laws)
    if scenes := source.summary.get("scenes"):
        exposures = {scene["name"]: {**scene["exposure"], "unit": scene["unit"]} for scene in scenes}
        assumption = _add(
            case, "A", text=f"{source.name}: scenes are met as often as stated", exposures=exposures
        )
        yield assumption
        _add_doubts(case, assumption, _list_exposure_doubts(source))


def _add_doubts(case: Case, challenged: str, doubts: Iterable[str]) -> None:
    for text in dict.fromkeys(doubts):
        _add(case, "CG", text=text, challenges=challenged, undeveloped=True)


def _list_run_doubts(run: Run) -> Iterator[str]:
    assert run.definition is not None
    yield from (message.partition(": ")[2] or message for message, _ in run.definition.warnings)
    if run.provenance.uncommitted_changes is not False:
        yield "The repository had changes that no commit has: the commit does not identify the files"


def _list_exposure_doubts(source: Source) -> Iterator[str]:
    from scipy.special import chdtri

    exposures = {run.name: run.definition.exposure for run in source.runs.values() if run.definition}
    for name, exposure in exposures.items():
        if exposure is None:
            yield f"Scene {name} has no exposure: shares of cells of a grid say nothing on rates of the road"
        elif exposure.counts and sum(exposure.counts):
            scatter = variance(exposure.counts) / mean(exposure.counts)
            freedom = len(exposure.counts) - 1
            if scatter * freedom > chdtri(freedom, 0.05):
                yield (
                    f"Scene {name}: its counts scatter {scatter:.2g} times as much as Poisson's: the "
                    "interval is widened by that, and holds as far as the blocks are independent"
                )
        elif exposure.count is None and exposure.interval is None:
            yield f"Scene {name}: its exposure is stated without an interval, and counts as known exactly"


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
        relation: element.get(relation) or () for relation in ("supportedBy", "inContextOf", "challenges")
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
        key for key, element in elements.items() if not (isinstance(element, dict) and "text" in element)
    ]
    if broken:
        return [f"V01 {key}: it has no text" for key in broken]
    links = {key: list_links(element) for key, element in elements.items()}
    faults = [fault for key, element in elements.items() for fault in _find_faults_of(key, element, links)]
    referred = {target for pairs in links.values() for _, target in pairs}
    tops = [key for key in elements if key not in referred and find_prefix(key) not in ("CG", "CSn")]
    if len(tops) != 1 or find_prefix(tops[0]) != "G":
        faults.append(f"C01 one goal should stand above all, not {', '.join(tops) or 'none'}")
    supports = {key: {target for kind, target in links[key] if kind == "supportedBy"} for key in elements}
    while leaves := [key for key, targets in supports.items() if not targets & supports.keys()]:
        for key in leaves:
            del supports[key]
    return faults + [f"C04 {key}: its support leads in a circle" for key in supports]


def _find_faults_of(key: str, element: Mapping[str, Any], links: Links) -> Iterator[str]:
    prefix, targets = find_prefix(key), links[key]
    is_challenged = any(("challenges", key) in pairs for pairs in links.values())
    is_counter = prefix in ("CG", "CSn")
    allowed = {
        "supportedBy": _SUPPORTS.get(prefix, ()),
        "inContextOf": ("C", "A", "J"),
        "challenges": _PREFIXES,
    }
    rules = {
        f"V01 {key}: its id begins with none of {', '.join(_PREFIXES)}": bool(prefix),
        f"V02 {key}: it needs either support or `undeveloped: true`": prefix not in _SUPPORTS
        or bool(element.get("supportedBy")) != bool(element.get("undeveloped")),
        f"V05 {key}: it refers twice to the same element": len(set(targets)) == len(targets),
        f"V06 {key}: it refers to itself": all(target != key for _, target in targets),
        f"V10 {key}: it is marked as defeated, but nothing challenges it": is_challenged
        or not element.get("defeated"),
        f"V12 {key}: only counter goals and counter solutions challenge": is_counter
        or "challenges" not in dict(targets),
    }
    yield from (fault for fault, is_kept in rules.items() if not is_kept)
    for relation, target in targets:
        if target not in links:
            yield f"C03 {key}: {relation} refers to {target}, which is missing"
        elif find_prefix(target) not in allowed[relation]:
            yield f"V04 {key}: {relation} cannot refer to {target}"
