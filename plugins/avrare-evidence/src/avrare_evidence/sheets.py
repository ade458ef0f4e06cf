"""Test-case sheets with the fields of ISO 34505: identity, objective, inputs, steps, platform, results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from avrare.results.run import Run
from avrare.scenario.schema import Block, Formula
from avrare_evidence.claims import Claim
from avrare_evidence.sources import Source, list_files, list_laws, list_models

Sheet = dict[str, Any]


def name_sheet(source: Source, place: str) -> str:
    """Return the path of a run's sheet in the pack."""
    return f"test-cases/{source.name}/{place}".rstrip("/") + ".yaml"


def describe_test_case(source: Source, place: str, run: Run, claims: Sequence[Claim]) -> Sheet:
    """Return the sheet of a scenario or scene; ``claims`` are those of the source."""
    scenario, origin = run.definition, run.provenance
    assert scenario is not None
    laws, exposure = list_laws(scenario), scenario.exposure
    files = (f"{source.home}{place}result.json", source.home + source.file)
    claimed = [claim.measure for claim in claims if claim.file in files and claim.measure["rule"] in run]
    return {
        "source": source.name,
        "id": f"{run.name}@{run.fingerprint}",
        "objective": scenario.objective or scenario.description,
        "requirements": list(scenario.requirements),
        "odd": list(scenario.odd),
        "scenario": {
            "name": run.name,
            "file": f"{source.home}{place}scenario.yaml",
            "exposure": exposure.model_dump(mode="json", exclude_none=True) if exposure else None,
            "complexity": {"drawn_options": len(laws), "components": len(scenario.blocks)},
        },
        "inputs": {
            "stack": {key: block.plugin for key, block in scenario.blocks.items() if "." not in key},
            "rules": {name: _describe_rule(scenario.specifications[name]) for name in run},
            "laws": laws,
            "files": {option: path.name for option, path in list_files(scenario).items()},
            "models": {option: path.name for option, path in list_models(scenario).items()},
            "seed": run.seed,
        },
        "steps": {
            "number": scenario.steps,
            "dt_seconds": scenario.simulator.config.model_dump().get("dt"),
            "budget": origin.budget or "as the estimator's options say",
        },
        "platform": {
            "versions": dict(run.versions),
            "python": origin.python,
            "date": origin.date.date().isoformat() if origin.date else None,
            "commit": origin.commit or None,
            "uncommitted_changes": origin.uncommitted_changes,
        },
        "expected": [f"{measure['rule']} {measure['bound']}" for measure in claimed if measure["bound"]],
        "actual": {
            "estimates": {
                name: {
                    "value": result.probability,
                    "interval": list(result.interval),
                    "failures": result.failures.count,
                    "rollouts": result.rollouts,
                    "errors": result.errors,
                }
                for name, result in run.items()
            },
            "verdicts": {f"{x['rule']} {x['bound']}": x["verdict"] for x in claimed if x["bound"]},
        },
    }


def _describe_rule(rule: Block | Formula) -> object:
    """Return the formula of a rule, or its plugin with the options that differ from their defaults."""
    if isinstance(rule, Block):
        return {"plugin": rule.plugin, **rule.config.model_dump(mode="json", exclude_defaults=True)}
    return rule.stl
