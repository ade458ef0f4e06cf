"""Record of run folders in MLflow: a run for each, with parameters, metrics and files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from avrare.base.errors import PluginError
from avrare.results.run import Run

VARIABLE = "MLFLOW_TRACKING_URI"


def on_result(run: Run) -> str | None:
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
    name = f"avrare {run.name}"
    present = client.get_experiment_by_name(name)
    experiment = client.create_experiment(name) if present is None else present.experiment_id
    commit = run.provenance.commit
    tags = {"fingerprint": run.fingerprint, "commit": commit, "verdict": run.verdict or ""}
    warnings = sorted({name for result in run.values() for name in result.health})
    assert run.folder is not None  # callbacks are given runs of folders
    tags |= {"warnings": ", ".join(warnings), "mlflow.runName": run.folder.name}
    record = client.create_run(experiment, tags=tags).info.run_id
    for key, value in _list_parameters(run):
        client.log_param(record, key, value)
    for key, number in _list_metrics(run):
        client.log_metric(record, key, number)
    for file in ("result.json", "scenario.yaml", "provenance.json", "failures.npz", "report.html"):
        if (run.folder / file).is_file():
            client.log_artifact(record, str(run.folder / file))
    client.set_terminated(record, "FAILED" if run.verdict == "fail" else "FINISHED")
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


def _list_parameters(run: Run) -> Iterator[tuple[str, str]]:
    yield "seed", str(run.seed)
    yield "estimator", next(iter(run.values())).estimator
    if run.provenance.budget:
        yield "budget", run.provenance.budget
    yield from run.versions.items()


def _list_metrics(run: Run) -> Iterator[tuple[str, float]]:
    metrics = ("probability", "relative_error", "blind_bound", "rollouts", "failures", "errors", "seconds")
    for specification, result in run.items():
        for name, number in result.to_dict().items():
            if name in metrics and isinstance(number, (int, float)):
                yield f"{specification}/{name}", float(number)
        for name, end in zip(("low", "high"), result.interval, strict=True):
            yield f"{specification}/{name}", end
