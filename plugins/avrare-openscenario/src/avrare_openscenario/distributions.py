"""Laws and sets of parameters from OpenSCENARIO files of parameter distributions."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.plugin.component import FoundScene
from avrare_openscenario.parameters import Parameters
from avrare_openscenario.xml_tree import Element, read_xml

_LAWS = (
    "NormalDistribution",
    "LogNormalDistribution",
    "UniformDistribution",
    "Histogram",
    "ProbabilityDistributionSet",
)
_Axis = tuple[dict[str, str], ...]


def list_scenes(path: str, ego: str | None) -> list[FoundScene]:
    """Return the scenes of a file, or of all files .xosc below a folder.

    A file of parameter sets or laws stands for the scenario that it names. What is wrong in a file is told
    where its scene is read.
    """
    options = {"entity": ego or "Ego", "ignore_ego_events": True}
    scenes: list[FoundScene] = []
    templates: set[str] = set()
    for file in sorted(map(str, Path(path).rglob("*.xosc"))) if os.path.isdir(path) else [path]:
        named, axes = file, tuple[_Axis]()
        with suppress(UsageError):
            top = read_xml(file, "OpenSCENARIO")
            if top.find("Catalog") is not None:
                continue
            if (block := top.find("ParameterValueDistribution")) is not None:
                templates.add(template := _find_template(block))
                if (sets := block.find("Deterministic")) is not None:
                    named, axes = template, tuple(map(_read_axis, sets.children))
        scenes.append(FoundScene(file, {**options, "file": named}, axes))
    return [scene for scene in scenes if os.path.normpath(scene.path) not in templates]


def _find_template(block: Element) -> str:
    return os.path.normpath(Parameters(None, {}, block.path).path(block.child("ScenarioFile"), "filepath"))


def _read_axis(element: Element) -> _Axis:
    choices = element.choice("DistributionSet", "DistributionRange", "ValueSetDistribution")
    prefix = "parameters."
    if choices.tag == "ValueSetDistribution":
        sets = (block.list("ParameterAssignment") for block in choices.list("ParameterValueSet"))
        return tuple(
            {prefix + value.attribute("parameterRef"): _read_value(value) for value in values}
            for values in sets
        )
    name = prefix + element.attribute("parameterName")
    if choices.tag == "DistributionSet":
        return tuple({name: _read_value(choice)} for choice in choices.list("Element"))
    step, bounds = choices.number("stepWidth"), _range(choices.child("Range"))
    if step <= 0.0 or bounds["high"] < bounds["low"]:
        raise choices.error("stepWidth should be above 0, and upperLimit not below lowerLimit")
    count = math.floor((bounds["high"] - bounds["low"]) / step + 1e-9) + 1
    return tuple({name: f"{bounds['low'] + k * step:.12g}"} for k in range(count))


def _read_value(element: Element) -> str:
    # As written; of an expression, its value.
    written = element.attribute("value")
    if not written.startswith("${"):
        return written
    return f"{Parameters(None, {}, element.path).read_number(element, 'value'):.12g}"


def read_distributions(top: Element) -> tuple[str, dict[str, dict[str, object]]]:
    """Return the scenario's file and the law of each parameter, as a scenario would write it.

    Raises:
        UsageError: A distribution is not read, or values are given without probabilities.
    """
    top.child("FileHeader").skip()
    block = top.child("ParameterValueDistribution")
    file = _find_template(block)
    if deterministic := block.find("Deterministic"):
        raise deterministic.error(
            "values without probabilities are no distribution",
            "`avrare new catalogue FILE` lists them as scenes of a catalogue",
        )
    stochastic = block.child("Stochastic")
    laws: dict[str, dict[str, object]] = {}
    stochastic.ignore("numberOfTestRuns", "randomSeed")  # of the estimator and the scenario
    for element in stochastic.list("StochasticDistribution"):
        name = element.attribute("parameterName")
        if not name.isidentifier():
            raise element.error(f"{name!r} is no name of a parameter", "letters, digits and _")
        if name in laws:
            raise element.error(f"a second distribution of {name!r}")
        laws[name] = _read_law(element.choice(*_LAWS))
    top.refuse_unread()
    return file, laws


def _read_law(element: Element) -> dict[str, object]:
    if element.tag == "UniformDistribution":
        return _read_uniform(element)
    if element.tag == "ProbabilityDistributionSet":
        return _read_set(element)
    if element.tag == "Histogram":
        bins = [(_not_negative(entry, "weight"), _read_uniform(entry)) for entry in element.list("Bin")]
        bins = [(weight, law) for weight, law in bins if weight != 0.0]
        if not bins:
            raise element.error("has no bin with a weight")
        if len(bins) == 1:
            return bins[0][1]
        return {"law": "mixture", "parts": [{"weight": weight, "of": law} for weight, law in bins]}
    mean, sd = element.number("expectedValue"), _not_negative(element, "variance") ** 0.5
    law = {"law": element.tag.removesuffix("Distribution").lower(), "mean": mean, "sd": sd}
    bounds = element.find("Range")
    return law if bounds is None else {"law": "truncated", "of": law, **_range(bounds)}


def _read_uniform(element: Element) -> dict[str, object]:
    return {"law": "uniform", **_range(element.child("Range"))}


def _read_set(element: Element) -> dict[str, object]:
    weights: dict[float, float] = {}
    for choice in element.list("Element"):
        value = choice.number("value")
        weights[value] = weights.get(value, 0.0) + _not_negative(choice, "weight")
    values = sorted(value for value, weight in weights.items() if weight > 0.0)
    if len(values) < 2:
        text = "has fewer than two values with a weight"
        raise element.error(text, "give the parameter a fixed value under `parameters`")
    return {"law": "discrete", "values": values, "weights": [weights[value] for value in values]}


def _range(bounds: Element) -> dict[str, float]:
    return {"low": bounds.number("lowerLimit"), "high": bounds.number("upperLimit")}


def _not_negative(element: Element, name: str) -> float:
    value = element.number(name)
    if value < 0.0:
        raise element.error(f"{name} should not be below 0, found {value:g}")
    return value
