"""Small packs for the tests: a point on a line that fails beyond a bound."""

import avrare
from avrare_evidence.argument import STATES
from avrare_evidence.pack import write_pack

SCENARIO = """\
name: point
description: A point on a line
requirements: [R-1]
odd: [dry]
objective: stay below the bound
steps: 0
simulator: {plugin: linear, states: [x], A: [[1]], initial: {mean: [0], covariance: [1]}}
specifications: {below: {stl: x < 2}}
estimator: {plugin: mc, rollouts: 4000}
thresholds: [{specification: below, probability: "< 0.04"}]
"""


def make_pack(point, *overrides, estimator=None, name="pack"):
    avrare.run(point / "point.yaml", overrides, out=point / f"run-{name}", estimator=estimator)
    return write_pack([point / f"run-{name}"], point / name)


def list_claims(pack):
    return [element for element in pack.case.values() if element.measure]


def list_states(pack):
    return [STATES[claim.measure.verdict] for claim in list_claims(pack)]


def list_challenges(pack):
    return [element for element in pack.case.values() if element.challenges == "G2"]


def replace(folder, old, new):
    text = (folder / "manifest.json").read_text()
    assert old in text
    (folder / "manifest.json").write_text(text.replace(old, new, 1))
