"""Test-case sheets with the fields of ISO 34505: identity, objective, inputs, steps, platform, results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.estimation.result.result import finite
from avrare.results.run import Run
from avrare.scenario.schema import Block, Formula
from avrare_evidence.claims import Statement
from avrare_evidence.manifest import PackedRun

Sheet = dict[str, Any]


def describe_test_case(run: Run, entry: PackedRun, claims: Sequence[Statement]) -> Sheet:
    """Return the sheet of a run; ``claims`` are those that it supports, alone or with others."""
    scenario = run.definition
    assert scenario is not None
    measures = [claim.measure for claim in claims if claim.measure is not None and claim.measure.rule in run]
    verdicts = {f"{measure.rule} {measure.bound}": measure.verdict for measure in measures if measure.bound}
    draws, exposure = scenario.simulator.draws, scenario.exposure
    laws = dict(zip(draws.names, draws.laws, strict=True)) if draws is not None else {}
    return {
        "id": f"{run.name}@{run.fingerprint}",
        "scenario": entry.folder + SCENARIO,
        "objective": scenario.objective or scenario.description,
        "requirements": list(scenario.requirements),
        "odd": list(scenario.odd),
        "exposure": exposure.model_dump(mode="json", exclude_defaults=True) if exposure else None,
        "complexity": {"drawn_options": len(laws), "components": len(scenario.blocks)},
        "inputs": {
            "stack": {key: block.plugin for key, block in scenario.blocks.items() if "." not in key},
            "rules": {name: _describe_rule(scenario.specifications[name]) for name in run},
            "laws": {name: json.loads(law.model_dump_json(exclude_none=True)) for name, law in laws.items()},
            "files": entry.files,
            "seed": run.seed,
        },
        "steps": {"number": scenario.steps, "dt_seconds": scenario.simulator.config.model_dump().get("dt")},
        "platform": {**run.versions, **run.provenance.to_dict()},
        "expected": list(verdicts),
        "actual": {"estimates": [finite(row) for row in run.table()], "verdicts": verdicts},
    }


def _describe_rule(rule: Block | Formula) -> object:
    """Return the formula of a rule, or its plugin with the options that differ from their defaults."""
    if isinstance(rule, Block):
        return {"plugin": rule.plugin, **rule.config.model_dump(mode="json", exclude_defaults=True)}
    return rule.stl
