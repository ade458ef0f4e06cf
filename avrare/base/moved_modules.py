"""Aliases of renamed modules that plugin authors import; they are kept for one release."""

from __future__ import annotations

import importlib
import warnings
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MOVED = {
    "avrare.api": "avrare.estimation.estimate_problem",
    "avrare.authors": "avrare.testing.conformance",
    "avrare.authors.outcome": "avrare.testing.conformance.suite",
    "avrare.authors.road": "avrare.testing.conformance.sample_traffic",
    "avrare.authors.subject": "avrare.testing.conformance.suite",
    "avrare.authors.suite": "avrare.testing.conformance.suite",
    "avrare.batch": "avrare.base.batch",
    "avrare.build": "avrare.stack",
    "avrare.build.closed_loop": "avrare.stack.closed_loop",
    "avrare.build.rules": "avrare.stack.builder",
    "avrare.build.scenario": "avrare.rollout.loaded_scenario",
    "avrare.build.stack": "avrare.stack.builder",
    "avrare.build.weighted": "avrare.rollout.weighted_problem",
    "avrare.errors": "avrare.base.errors",
    "avrare.estimation.checks": "avrare.estimation.result_builder",
    "avrare.estimation.config": "avrare.estimation.monte_carlo_config",
    "avrare.estimation.montecarlo": "avrare.estimation.monte_carlo",
    "avrare.estimation.sequential": "avrare.estimation.stopping_rules",
    "avrare.execute": "avrare.rollout.executors",
    "avrare.execute.config": "avrare.rollout.executors.serial",
    "avrare.execute.processes": "avrare.rollout.executors.processes",
    "avrare.execute.serial": "avrare.rollout.executors.serial",
    "avrare.execute.window": "avrare.rollout.executors.in_flight",
    "avrare.execute.work": "avrare.rollout.executors.work",
    "avrare.failures": "avrare.analysis.failures",
    "avrare.failures.clusters": "avrare.analysis.failures.clusters",
    "avrare.failures.falsify": "avrare.analysis.failures.falsify",
    "avrare.failures.shrink": "avrare.analysis.failures.shrink",
    "avrare.logic.algebra": "avrare.logic.semantics.value_algebra",
    "avrare.logic.api": "avrare.logic.formula",
    "avrare.logic.normal": "avrare.logic.semantics.normal_form",
    "avrare.logic.online": "avrare.logic.monitor.monitors",
    "avrare.logic.printing": "avrare.logic.syntax.printer",
    "avrare.logic.robustness": "avrare.logic.semantics.trace_evaluator",
    "avrare.logic.semantics.terms": "avrare.logic.semantics.trace_evaluator",
    "avrare.logic.terms": "avrare.logic.semantics.trace_evaluator",
    "avrare.plugin.finding": "avrare.plugin.component",
    "avrare.plugin.known": "avrare.plugin.first_party",
    "avrare.plugin.hookspecs": "avrare.plugin.component",
    "avrare.plugin.rule_card": "avrare.plugin.component",
    "avrare.plugin.rulecard": "avrare.plugin.component",
    "avrare.pytest_plugin": "avrare.cli.pytest_plugin",
    "avrare.record": "avrare.results",
    "avrare.record.whole": "avrare.base.atomic_files",
    "avrare.rollout.danger": "avrare.rollout.scores.progress_score",
    "avrare.rollout.deciding": "avrare.rollout.early_stop",
    "avrare.rollout.progress": "avrare.rollout.scores.progress_score",
    "avrare.rollout.score": "avrare.rollout.scores.scored_specifications",
    "avrare.scenario.files": "avrare.scenario.fingerprint",
    "avrare.scenario.jsonschema": "avrare.scenario.json_schema",
    "avrare.testing.chain": "avrare.testing.exact_chain_probabilities",
    "avrare.testing.flows": "avrare.testing.static_problems",
    "avrare.testing.lattices": "avrare.testing.walk_problems",
    "avrare.testing.problem": "avrare.testing.reference_problem",
    "avrare.testing.reach": "avrare.testing.walk_problems",
    "avrare.testing.response": "avrare.testing.walk_problems",
    "avrare.testing.static": "avrare.testing.static_problems",
    "avrare.testing.study": "avrare.testing.repeated_estimates",
    "avrare.testing.systems": "avrare.testing.faulty_systems",
    "avrare.testing.walks": "avrare.testing.walk_problems",
    "avrare.worlds.branches": "avrare.worlds.world_histories",
    "avrare.worlds.channel": "avrare.worlds.noisy_world",
    "avrare.worlds.noisy": "avrare.worlds.noisy_world",
    "avrare.worlds.simulator": "avrare.worlds.worlds_simulator",
    "avrare.worlds.system": "avrare.worlds.worlds_simulator",
    "avrare.worlds.timeout": "avrare.worlds.step_timeout",
}
"""New paths by old paths."""

RENAMED = {
    "avrare.build.scenario": {"BuildableScenario": "avrare.rollout.loaded_scenario.LoadedScenario"},
    "avrare.build.weighted": {
        "Law": "avrare.stack.closed_loop.SamplingLaw",
        "WeightedState": "avrare.stack.closed_loop.WeightedLoopState",
        "check_block": "avrare.rollout.weighted_problem.check_proposal",
    },
    "avrare.record.whole": {
        "ready": "avrare.base.atomic_files.ensure_writable",
        "write_whole": "avrare.base.atomic_files.write_atomic",
    },
}
"""Renamed members of moved modules: old name -> new path."""


class MovedModules:
    """Import hook that gives the module at the new path under the old one.

    It comes before the usual finders: below the alias of a package these would load a second copy of a module
    that has kept its name.
    """

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Return the spec of an old path, None for any other name."""
        loader: Any = self  # not a Loader by inheritance: importlib.abc would slow down ``import avrare``
        return ModuleSpec(name, loader) if name in MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import the module at its new path, with a deprecation warning."""
        new = MOVED[spec.name]
        warnings.warn(f"{spec.name} is now {new}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(new)
        for name, path in RENAMED.get(spec.name, {}).items():
            home, _, renamed = path.rpartition(".")
            setattr(module, name, getattr(importlib.import_module(home), renamed))
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own spec: it has been executed under its new name already."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state
