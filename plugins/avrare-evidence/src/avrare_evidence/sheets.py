"""Test-case sheets with the fields of ISO 34505: identity, objective, inputs, steps, platform, results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from avrare.results.run import Run
from avrare_evidence.claims import Claim
from avrare_evidence.sources import Source, list_laws


def describe_test_case(source: Source, place: str, run: Run, claims: Sequence[Claim]) -> dict[str, Any]:
    """Return the sheet of a scenario or scene; ``claims`` are those of the source."""
    scenario, origin, laws = run.definition, run.provenance, {}
    assert scenario is not None
    laws = list_laws(scenario)
    scenes = {
        scene["name"]: {**scene["exposure"], "unit": scene["unit"]}
        for scene in source.summary.get("scenes", ())
    }
    return {
        "id": f"{run.name}@{run.fingerprint}",
        "objective": scenario.objective or scenario.description,
        "requirements": list(scenario.requirements),
        "odd": list(scenario.odd),
        "scenario": {
            "file": f"{source.home}{place}scenario.yaml",
            "frequency": scenes.get(run.name),
            "complexity": {"drawn_options": len(laws), "parts": len(scenario.blocks)},
        },
        "inputs": {"laws": laws, "seed": run.seed, "estimator": scenario.estimator.plugin},
        "steps": {
            "number": scenario.steps,
            "dt_seconds": scenario.simulator.config.model_dump().get("dt"),
            "budget": origin.budget or "as the estimator's options say",
        },
        "platform": {
            "versions": dict(run.versions),
            "python": origin.python,
            "commit": origin.commit or None,
            "uncommitted_changes": origin.uncommitted_changes,
        },
        "expected": {claim.measure["rule"]: claim.measure["bound"] for claim in claims},
        "actual": {
            "estimates": {name: [result.probability, *result.interval] for name, result in run.items()},
            "verdicts": {claim.measure["rule"]: claim.measure["verdict"] for claim in claims},
        },
    }
