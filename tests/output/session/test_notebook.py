"""The notebook of the documentation runs, and its stored outputs are those of its code."""

import importlib.util
import json
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / "docs" / "notebooks"
SMALLER = {
    '"ams", seed=1': '"ams", seed=1, particles=40, discard=8, runs=2',
    '"ess", seed=2': '"ess", seed=2, chains=40, runs=2',
    "rollouts=5000": "rollouts=500",
}


@pytest.fixture(scope="module")
def execute():
    spec = importlib.util.spec_from_file_location("execute", FOLDER / "execute.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.execute


@pytest.mark.slow
def test_the_notebook_runs(execute):
    notebook = json.loads((FOLDER / "first-hour.ipynb").read_text(encoding="utf-8"))
    stored = [[sorted(one.get("data", {})) for one in cell.get("outputs", [])] for cell in notebook["cells"]]
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        for large, small in SMALLER.items():
            assert cell["cell_type"] != "code" or large not in source or source.count(large) == 1
            source = source.replace(large, small)
        cell["source"] = [source]
    execute(notebook)
    kinds = [[sorted(one.get("data", {})) for one in cell.get("outputs", [])] for cell in notebook["cells"]]
    assert kinds == stored
    assert sum("image/png" in kind for cell in kinds for kind in cell) == 4


def test_a_cell_that_fails_is_not_hidden(execute):
    with pytest.raises(ZeroDivisionError):
        execute({"cells": [{"cell_type": "code", "source": ["1 / 0"]}]})


def test_outputs_are_what_is_printed_and_shown(execute):
    notebook = {"cells": [{"cell_type": "code", "source": ["print('hello')\n", "21 * 2"]}]}
    execute(notebook)
    stream, value = notebook["cells"][0]["outputs"]
    assert stream["text"] == ["hello\n"]
    assert value["data"] == {"text/plain": ["42"]}
