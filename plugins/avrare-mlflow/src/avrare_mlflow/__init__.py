"""Record of run folders in MLflow: a run for each, with parameters, metrics and files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from avrare.base.errors import PluginError
from avrare.estimation.result import worst_verdict
from avrare.results.reader import RunFolder

VARIABLE = "MLFLOW_TRACKING_URI"
_METRICS = ("probability", "relative_error", "blind_bound", "rollouts", "failures", "errors", "seconds")
_FILES = ("result.json", "scenario.yaml", "provenance.json", "failures.npz", "report.html")


def on_result(run: RunFolder) -> str | None:
    """Record a run folder where ``MLFLOW_TRACKING_URI`` is set, for instance ``file:./mlruns``.

    Returns:
        A line that names the MLflow run, or None where nothing is recorded.

    Raises:
        PluginError: MLflow is not installed.
    """
    address = os.environ.get(VARIABLE)
    if not address:
        return None
    client = _connect(address)
    result, origin = run.result, run.provenance
    name = f"avrare {result.scenario}"
    known = client.get_experiment_by_name(name)
    experiment = client.create_experiment(name) if known is None else known.experiment_id
    verdict = worst_verdict(one.verdict for one in result.estimates)
    tags = {"fingerprint": result.fingerprint, "commit": origin.commit, "verdict": verdict or ""}
    warnings = sorted({name for one in result.estimates for name in one.health})
    tags |= {"warnings": ", ".join(warnings), "mlflow.runName": run.path.name}
    record = client.create_run(experiment, tags=tags).info.run_id
    for key, value in _list_parameters(run):
        client.log_param(record, key, value)
    for key, number in _list_metrics(run):
        client.log_metric(record, key, number)
    for file in _FILES:
        if (run.path / file).is_file():
            client.log_artifact(record, str(run.path / file))
    client.set_terminated(record, "FAILED" if verdict == "fail" else "FINISHED")
    return f"MLflow: run {record} of experiment {name!r}"


def _connect(address: str) -> Any:
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    try:
        from mlflow import MlflowClient
    except ImportError:
        raise PluginError(
            f"{VARIABLE} is set, but MLflow is not installed", "pip install mlflow-skinny"
        ) from None
    return MlflowClient(tracking_uri=address)


def _list_parameters(run: RunFolder) -> Iterator[tuple[str, str]]:
    yield "seed", str(run.result.seed)
    yield "estimator", run.result.estimates[0].estimator
    if run.provenance.budget:
        yield "budget", run.provenance.budget
    yield from run.result.versions.items()


def _list_metrics(run: RunFolder) -> Iterator[tuple[str, float]]:
    for one in run.result.estimates:
        low, high = one.interval
        numbers = {"low": low, "high": high, **{name: getattr(one, name) for name in _METRICS}}
        for name, number in numbers.items():
            if number is not None:
                yield f"{one.specification}/{name}", float(number)
