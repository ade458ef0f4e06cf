"""Argument of a pack in goal structuring notation (GSN v3), as gsn2x writes it in YAML, and its rules.

Counter goals and counter solutions, which challenge other elements, are those of its dialectic extension.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from graphlib import CycleError, TopologicalSorter
from statistics import mean, variance
from typing import Any

from pydantic import BaseModel, ConfigDict, TypeAdapter
from pydantic.alias_generators import to_camel

from avrare.analysis.rates.catalogue_document import SceneEntry
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.number_format import format_interval, format_probability
from avrare.results.run import RESULT
from avrare_evidence.sources import Claim, Measure, Source, list_claims

_FAULTS = {"fail": "does not keep to", "inconclusive": "reaches past"}
"""Verdict -> relation of the interval to the bound."""
_SUPPORT = {"G": ("G", "S", "Sn"), "S": ("G", "S", "Sn"), "CG": ("CG", "G", "S", "Sn", "CSn")}
_SUPPORT |= dict.fromkeys(("Sn", "CSn", "C", "A", "J"), ())
"""Kind of an element -> kinds that support it."""
_COUNTERS = ("CG", "CSn")
"""Kinds that challenge."""
_TARGETS = {"inContextOf": ("C", "A", "J"), "challenges": tuple(_SUPPORT)}
"""Relation -> kinds to which it leads; support depends on the kind that is supported."""
STATES = {
    "pass": "holds",
    "pass_assuming": "holds as far as the search could see",
    "inconclusive": "not shown",
    "fail": "refuted",
    None: "measured, no bound asked",
}
"""Verdict -> state of a claim."""


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
        links = [("supportedBy", target) for target in self.supported_by]
        links += [("inContextOf", target) for target in self.in_context_of]
        return links + ([("challenges", self.challenges)] if self.challenges else [])


Case = dict[str, Element]
"""Elements by id."""
CASES = TypeAdapter(Case)
"""Reader and writer of a case."""


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
    kind = key.rstrip("0123456789")
    return kind if kind in _SUPPORT and kind != key else ""


def find_faults(case: Case) -> list[str]:
    """Return a line for each rule of gsn2x that a case breaks, with the rule's number."""
    links = {link for element in case.values() for link in element.links}
    faults, below = list[str](), {target for _, target in links}
    tops = [key for key in case if key not in below and find_kind(key) not in _COUNTERS]
    if [find_kind(key) for key in tops] != ["G"]:
        faults.append(f"C01 one goal should stand above all, not {', '.join(tops) or 'none'}")
    for key, element in case.items():
        kind, targets = find_kind(key), [target for _, target in element.links]
        is_bare = bool(_SUPPORT.get(kind)) and bool(element.supported_by) == element.undeveloped
        is_doubted = ("challenges", key) in links
        broken = {
            f"V01 {key}: its id begins with none of {', '.join(_SUPPORT)}": not kind,
            f"V02 {key}: it needs either support or `undeveloped: true`": is_bare,
            f"V05 {key}: it refers twice to the same element": len({*targets}) < len(targets),
            f"V06 {key}: it refers to itself": key in targets,
            f"V10 {key}: it is marked as defeated, but nothing challenges it": element.defeated > is_doubted,
        }
        for relation, target in element.links:
            is_allowed = find_kind(target) in _TARGETS.get(relation, _SUPPORT.get(kind, ()))
            is_counter = relation != "challenges" or kind in _COUNTERS
            broken |= {
                f"C03 {key}: {relation} refers to {target}, which is missing": target not in case,
                f"V04 {key}: {relation} cannot refer to {target}": target in case and not is_allowed,
                f"V12 {key}: only counter goals and counter solutions challenge": not is_counter,
            }
        faults += [rule for rule, is_broken in broken.items() if is_broken]
    try:
        TopologicalSorter({key: element.supported_by for key, element in case.items()}).prepare()
    except CycleError as error:
        faults.append(f"C04 {' -> '.join(error.args[1])}: the support leads in a circle")
    return faults


def build_case(sources: Sequence[Source], digests: Mapping[str, str]) -> Case:
    """Return the argument: a goal for each claim, and one above all; ``digests`` are of the pack's files."""
    case: Case = {}
    names = ", ".join(source.name for source in sources)
    top = add_element(case, "G", f"The stack keeps the rules of {names} as often as claimed")
    for source in sources:
        premises = list(_add_premises(case, source))
        text = f"{source.name}: estimate how often each rule is broken; a verdict needs the whole interval"
        strategy = add_element(case, "S", text, in_context_of=premises)
        case[top].supported_by.append(strategy)
        run, file = next(iter(source.runs.values())), f"{source.name}/{source.file}"
        seed = run.seed if source.rates is None else source.rates.catalogue.document.seed
        origin = {"seed": seed, "command": shlex.join(["avrare", *run.provenance.command[1:]])}
        digest = digests[f"evidence/{file}"]
        solution = add_element(case, "Sn", file, url=f"evidence/{file}", sha256=digest, **origin)
        for claim in list_claims(source):
            goal = add_element(case, "G", claim.text, supported_by=[solution], measure=claim.measure)
            case[strategy].supported_by.append(goal)
            _challenge_claim(case, goal, claim, source)
    return case


def _challenge_claim(case: Case, goal: str, claim: Claim, source: Source) -> None:
    """Add what is known against a claim: warnings, notes, its interval, and unseen failures."""
    doubt, measure = partial(add_challenge, case, goal), claim.measure
    for name, result in claim.results.items():
        file, check = f"evidence/{name}/{RESULT}", result.cross_check
        warnings = result.health if source.rates is None else SceneEstimate(result).warnings
        for key, message in warnings.items():
            doubt(f"Warning {key}: {message}", f"{file}#warnings.{key}", measure.verdict == "inconclusive")
        undecided = ("cross_check",) if check is not None and check.outcome == "inconclusive" else ()
        for note in result.notes:
            if note.kind in ("model", "goal", "errors", *undecided):
                doubt(note.text, f"{file}#notes")
    unit, file = f" {measure.unit}".rstrip(), f"evidence/{source.name}/{source.file}"
    if measure.verdict in _FAULTS and not case[goal].defeated:
        interval, fault = format_interval((measure.low, measure.high)), _FAULTS[measure.verdict]
        doubt(f"The interval {interval}{unit} {fault} {measure.bound}", f"{file}#interval", True)
    if measure.blind is not None:
        bound = format_probability(measure.blind)
        text = f"Failures that the search is not led to could be as likely as {bound}{unit}"
        checks = [result.cross_check for result in claim.results.values() if result.blind_bound is not None]
        agreeing = [check.estimator for check in checks if check is not None and check.outcome == "agree"]
        answer = f"A second estimate, by {', '.join(dict.fromkeys(agreeing))}, agrees"
        is_answered, decides = len(agreeing) == len(checks), measure.verdict == "pass_assuming"
        doubt(text, f"{file}#blind_bound", decides, answer if is_answered else "")


def _add_premises(case: Case, source: Source) -> Iterator[str]:
    """Add the scenarios, and the assumptions: laws of drawn options, and exposures; yield their ids."""
    names = ", ".join(dict.fromkeys(run.name for run in source.runs.values()))
    sheets = [f"test-cases/{name}.yaml" for name in source.runs]
    context = add_element(case, "C", f"Scenarios: {names}", sheets=sheets)
    for doubt in dict.fromkeys(_doubt_scenarios(source)):
        add_challenge(case, context, doubt)
    yield context
    if any(run.definition and run.definition.simulator.draws for run in source.runs.values()):
        yield add_element(case, "A", f"{source.name}: starts follow the laws of the drawn options")
    if source.rates is not None:
        assumption = add_element(case, "A", f"{source.name}: scenes are met as often as stated")
        for doubt in map(_doubt_exposure, source.rates.catalogue.document.scenes):
            if doubt:
                add_challenge(case, assumption, doubt)
        yield assumption


def _doubt_scenarios(source: Source) -> Iterator[str]:
    for run in source.runs.values():
        warnings = run.definition.warnings if run.definition is not None else ()
        yield from (message.partition(": ")[2] or message for message, _ in warnings)
        if run.provenance.uncommitted_changes is not False:
            yield "The repository had changes that no commit has: the commit does not identify the files"
    yield from (row.reason for row in source.summary.rows if row.question == "baseline")


def _doubt_exposure(scene: SceneEntry) -> str:
    from scipy.special import chdtri

    subject, exposure = f"Scene {scene.name}", scene.exposure
    if exposure is None:
        return f"{subject} has no exposure: shares of cells of a grid say nothing on rates of the road"
    if exposure.total is None and exposure.interval is None:
        return f"{subject}: its exposure is stated without an interval, and counts as known exactly"
    counts = exposure.counts if exposure.counts and sum(exposure.counts) else (1, 1)
    scatter, freedom = variance(counts) / mean(counts), len(counts) - 1
    text = f"its counts scatter {scatter:.2g} times as much as Poisson's: its interval is widened by that"
    is_wide = scatter * freedom > chdtri(freedom, 0.05)
    return f"{subject}: {text}, if the blocks are independent" if is_wide else ""
