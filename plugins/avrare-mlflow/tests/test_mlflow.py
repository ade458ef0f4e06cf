"""Records of run folders in MLflow."""

import json
from types import SimpleNamespace

import pytest

import avrare_mlflow
from avrare.base.errors import PluginError
from avrare.results.run import Run

ESTIMATE = {
    "specification": "in_lane", "estimator": "mc", "probability": 0.05, "interval": [0.04, 0.06],
    "confidence": 0.95, "relative_error": None, "rollouts": 2000, "simulated_steps": 2000, "failures": 100,
    "errors": 0, "seconds": 1.5, "health": ["few_roots"], "notes": [], "verdict": "fail",
}  # fmt: skip
CONTENT = {
    "schema": 1, "scenario": "drive", "fingerprint": "abcd", "seed": 3, "versions": {"avrare": "0.1.0"},
    "estimates": [ESTIMATE],
}  # fmt: skip


@pytest.fixture
def run(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.json").write_text(json.dumps(CONTENT))
    return Run.read(tmp_path / "run")


def test_nothing_is_recorded_without_an_address(run, monkeypatch):
    monkeypatch.delenv(avrare_mlflow.VARIABLE, raising=False)
    assert avrare_mlflow.on_result(run) is None


def test_missing_mlflow_is_named(run, monkeypatch, tmp_path):
    monkeypatch.setenv(avrare_mlflow.VARIABLE, f"sqlite:///{tmp_path}/m.db")
    monkeypatch.setitem(__import__("sys").modules, "mlflow", None)
    with pytest.raises(PluginError, match="MLflow is not installed"):
        avrare_mlflow.on_result(run)


class Client:
    """Stands for ``MlflowClient``: it remembers every call."""

    def __init__(self):
        self.calls = []

    def get_experiment_by_name(self, name):
        return None

    def __getattr__(self, name):
        def call(*words, **keywords):
            self.calls.append((name, words, keywords))
            return self if name == "create_run" else "7"

        return call

    info = SimpleNamespace(run_id="r1")


def test_numbers_tags_and_files_are_recorded(run, monkeypatch):
    client = Client()
    monkeypatch.setenv(avrare_mlflow.VARIABLE, "somewhere")
    monkeypatch.setattr(avrare_mlflow, "_connect", lambda address: client)
    assert avrare_mlflow.on_result(run) == "MLflow: run r1 of experiment 'avrare drive'"
    metrics = {words[1]: words[2] for name, words, _ in client.calls if name == "log_metric"}
    assert metrics["in_lane/probability"] == 0.05
    assert (metrics["in_lane/low"], metrics["in_lane/high"]) == (0.04, 0.06)
    assert "in_lane/relative_error" not in metrics
    (tags,) = [keywords["tags"] for name, _, keywords in client.calls if name == "create_run"]
    assert (tags["verdict"], tags["warnings"], tags["fingerprint"]) == ("fail", "few_roots", "abcd")
    assert ("log_artifact", ("r1", str(run.folder / "result.json")), {}) in client.calls
    assert ("set_terminated", ("r1", "FAILED"), {}) in client.calls


def test_mlflow_itself_reads_it_back(run, monkeypatch, tmp_path):
    mlflow = pytest.importorskip("mlflow")
    address = f"file:{tmp_path / 'mlruns'}"
    monkeypatch.setenv(avrare_mlflow.VARIABLE, address)
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    record = avrare_mlflow.on_result(run).split()[2]
    found = mlflow.MlflowClient(tracking_uri=address).get_run(record)
    assert found.data.metrics["in_lane/probability"] == 0.05
    assert found.data.params["seed"] == "3"
    assert found.info.status == "FAILED"
