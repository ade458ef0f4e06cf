"""Laws of parameters from OpenSCENARIO files of parameter distributions."""

from __future__ import annotations

import os

from avrare_openscenario.xml_tree import Element

_KNOWN = (
    "NormalDistribution, LogNormalDistribution, UniformDistribution, Histogram, ProbabilityDistributionSet"
)


def read_distributions(top: Element) -> tuple[str, dict[str, dict[str, object]]]:
    """Return the scenario's file and the law of each parameter, as a scenario would write it.

    Args:
        top: The element ``OpenSCENARIO`` of a file with a ``ParameterValueDistribution``.

    Raises:
        UsageError: A distribution is not read, or values are given without probabilities.
    """
    top.child("FileHeader").skip()
    block = top.child("ParameterValueDistribution")
    file = block.child("ScenarioFile").attribute("filepath")
    if deterministic := block.find("Deterministic"):
        raise deterministic.error(
            "values without probabilities are no distribution",
            "give the parameters fixed `parameters: {...}` in one scenario each, as entries of a catalogue",
        )
    stochastic = block.child("Stochastic")
    laws: dict[str, dict[str, object]] = {}
    for name in ("numberOfTestRuns", "randomSeed"):
        stochastic.get(name)  # the estimator's rollouts and the scenario's seed
    for one in stochastic.list("StochasticDistribution"):
        name = one.attribute("parameterName")
        if not name.isidentifier():
            raise one.error(f"{name!r} is no name of a parameter", "letters, digits and _")
        if name in laws:
            raise one.error(f"a second distribution of {name!r}")
        laws[name] = _read_law(one.choice())
    top.refuse_unread()
    return os.path.join(os.path.dirname(top.path), file), laws


def _read_law(one: Element) -> dict[str, object]:
    match one.tag:
        case "NormalDistribution":
            mean, sd = one.number("expectedValue"), _not_negative(one, "variance") ** 0.5
            return _cut(one, {"law": "normal", "mean": mean, "sd": sd})
        case "LogNormalDistribution":
            mean, sd = one.number("expectedValue"), _not_negative(one, "variance") ** 0.5
            return _cut(one, {"law": "lognormal", "mean": mean, "sd": sd})
        case "UniformDistribution":
            return {"law": "uniform", **_range(one.child("Range"))}
        case "Histogram":
            bins: list[tuple[float, dict[str, object]]] = [
                (_not_negative(part, "weight"), {"law": "uniform", **_range(part.child("Range"))})
                for part in one.list("Bin")
            ]
            bins = [(weight, law) for weight, law in bins if weight != 0.0]
            if not bins:
                raise one.error("has no bin with a weight")
            if len(bins) == 1:
                return bins[0][1]
            return {"law": "mixture", "parts": [{"weight": weight, "of": law} for weight, law in bins]}
        case "ProbabilityDistributionSet":
            return _read_set(one)
    raise one.unknown(_KNOWN)


def _read_set(one: Element) -> dict[str, object]:
    weights: dict[float, float] = {}
    for part in one.list("Element"):
        value = part.number("value")
        weights[value] = weights.get(value, 0.0) + _not_negative(part, "weight")
    kept = sorted(value for value, weight in weights.items() if weight > 0.0)
    if len(kept) < 2:
        text = "has fewer than two values with a weight"
        raise one.error(text, "give the parameter a fixed value under `parameters`")
    return {"law": "discrete", "values": kept, "weights": [weights[value] for value in kept]}


def _cut(one: Element, law: dict[str, object]) -> dict[str, object]:
    bounds = one.find("Range")
    return law if bounds is None else {"law": "truncated", "of": law, **_range(bounds)}


def _range(bounds: Element) -> dict[str, float]:
    return {"low": bounds.number("lowerLimit"), "high": bounds.number("upperLimit")}


def _not_negative(element: Element, name: str) -> float:
    value = element.number(name)
    if value < 0.0:
        raise element.error(f"{name} should not be below 0, found {value:g}")
    return value
