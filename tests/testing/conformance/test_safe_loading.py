"""Files are data: loading one never unpickles, and YAML makes nothing but plain values."""

import ast
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.base.errors import AvrareError

ROOT = Path(__file__).parents[3]
SOURCES = sorted([*(ROOT / "avrare").rglob("*.py"), *ROOT.glob("plugins/*/src/**/*.py")])

UNPICKLERS = {
    "avrare/rollout/child_process.py",
    "avrare/rollout/executors/processes.py",
    "plugins/avrare-ray/src/avrare_ray/executor.py",
}
"""They unpickle what another process of the same run has sent them."""
ITSELF = {"avrare/testing/conformance/description_checks.py"}
"""Unpickles what it has pickled in the line before."""

RUNNER = "avrare/stack/python_file.py"
"""Runs the Python file of a part, which safe mode refuses (test_python_file.py)."""

FORBIDDEN = {
    "eval", "exec", "compile", "__import__", "pickle.load", "pickle.Unpickler", "yaml.load",
    "yaml.unsafe_load",
    "yaml.full_load", "marshal.loads", "shelve.open", "joblib.load", "dill.load", "dill.loads", "os.system",
}  # fmt: skip


def calls(path):
    """Return (dotted name, call) of every call in a module."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func), node


def name(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", SOURCES, ids=name)
def test_no_file_is_unpickled(path):
    for function, call in calls(path):
        allowed = {"exec", "compile"} if name(path) == RUNNER else set()
        assert function not in FORBIDDEN - allowed, f"line {call.lineno}"
        if function in ("np.load", "numpy.load"):
            options = {word.arg: ast.unparse(word.value) for word in call.keywords}
            assert options.get("allow_pickle") == "False", f"line {call.lineno}"
        if function == "torch.load":
            options = {word.arg: ast.unparse(word.value) for word in call.keywords}
            assert options.get("weights_only") == "True", f"line {call.lineno}"
        if function.endswith("pickle.loads"):
            assert name(path) in UNPICKLERS | ITSELF, f"line {call.lineno}"


@pytest.mark.slow
def test_files_to_check_exist():
    found = [function for path in SOURCES for function, _ in calls(path)]
    assert "np.load" in found
    assert "yaml.dump" in found


class Bomb:
    """Writes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_model_with_a_pickle_in_it_is_refused(tmp_path):
    marker, model = tmp_path / "executed", tmp_path / "model.npz"
    np.savez(model, W0=np.array([Bomb(marker)], dtype=object), allow_pickle=True)
    with np.load(model, allow_pickle=True) as file:
        assert file["W0"].shape == (1,)
    assert marker.exists(), "the bomb is a dud"
    marker.unlink()
    text = (ROOT / "scenarios" / "pendulum.yaml").read_text()
    start, _, rest = text.partition("controller:")
    controller = f"controller: {{plugin: policy, model: {model}}}\n\n"
    scenario = tmp_path / "s.yaml"
    scenario.write_text(start + controller + rest[rest.index("specifications:") :])
    with pytest.raises(AvrareError, match=r"model\.npz|allow_pickle|network"):
        avrare.load(scenario).problem("upright")
    assert not marker.exists()
