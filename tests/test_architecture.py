"""The shape of the code: sizes, imports, and who may know whom."""

import ast
import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

from avrare.plugin.first_party import FIRST_PARTY

ROOT = Path(__file__).parents[1]
CORE = sorted((ROOT / "avrare").rglob("*.py"))
MODULES = [*CORE, *sorted(ROOT.glob("plugins/*/src/**/*.py"))]
HEAVY = {
    "torch", "pyro", "casadi", "matplotlib", "plotly", "ray", "pandas", "numba", "gymnasium", "scipy",
    "highway_env",
}  # fmt: skip


def imported(path):
    """Return top-level packages that a module imports anywhere."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (name.name.split(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


def loaded_by(code):
    """Return modules that are loaded after running ``code`` in a fresh interpreter."""
    script = f"{code}\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_files_to_check_exist():
    assert len(CORE) > 40
    assert len(MODULES) > len(CORE)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_are_short(path):
    assert len(path.read_text().splitlines()) <= 400


def test_no_module_is_called_utils():
    assert not [path for path in MODULES if path.stem in {"utils", "helpers", "common", "misc"}]


def test_the_core_has_at_most_fifteen_rooms():
    rooms = [
        path.name for path in (ROOT / "avrare").iterdir() if path.is_dir() and path.name != "__pycache__"
    ]
    modules = [path.name for path in (ROOT / "avrare").glob("[!_]*.py")]
    assert len(rooms + modules) <= 15, sorted(rooms + modules)


def test_the_architecture_page_has_a_line_for_every_room():
    page = (ROOT / "docs" / "architecture.md").read_text()
    named = set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    tops = [path for path in (ROOT / "avrare").iterdir() if not path.name.startswith(("_", "."))]
    assert named == {path.stem for path in tops if path.is_dir() or path.suffix == ".py"}


def test_every_test_file_is_collected(pytestconfig):
    ignored = pytestconfig.getini("norecursedirs")
    files = [
        path for folder in pytestconfig.getini("testpaths") for path in (ROOT / folder).rglob("test_*.py")
    ]
    assert len(files) > 100
    for path in files:
        folders = path.relative_to(ROOT).parts[:-1]
        assert not [part for part in folders for pattern in ignored if fnmatch(part, pattern)], path


def test_the_core_imports_no_plugin():
    for path in CORE:
        assert not {name for name in imported(path) if name.startswith("avrare_")}, path


OTHER_MEANINGS = {
    ("analysis/page/build.py", "is"): "the verb",
    ("cli/main.py", "policy"): "a command, with the distribution to install for it",
    ("testing/problems.py", "linear"): "a problem with an exact answer",
    ("testing/static_problems.py", "linear"): "a problem with an exact answer",
    ("testing/conformance/description_checks.py", "gymnasium"): "a package that is heavy to import",
    ("testing/conformance/description_checks.py", "ray"): "a package that is heavy to import",
}
"""Strings of the core that equal the name of a plugin's component, and mean something else."""


def find_constants(path):
    """Return the string constants of a module that are not docstrings."""
    nodes = list(ast.walk(ast.parse(path.read_text())))
    texts = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    constants = [node for node in nodes if isinstance(node, ast.Constant) and id(node) not in texts]
    return {node.value for node in constants if isinstance(node.value, str)}


def test_the_core_names_no_component_of_a_plugin():
    names = {name for _, name in FIRST_PARTY}
    assert {"ams", "ess_linear", "gp_pem"} <= names
    modules = {path.relative_to(ROOT / "avrare").as_posix(): path for path in CORE}
    named = {
        (module, word)
        for module, path in modules.items()
        if module != "plugin/first_party.py"
        for word in find_constants(path) & names
    }
    assert named == set(OTHER_MEANINGS)


@pytest.mark.parametrize("package", ["avrare", "avrare_estimators"])
def test_no_modules_import_each_other_circularly(package):
    import grimp

    graph = grimp.build_graph(package, exclude_type_checking_imports=False)
    for module in graph.modules:
        for imported_module in graph.find_modules_directly_imported_by(module):
            assert not graph.chain_exists(imported_module, module), (module, imported_module)


def test_import_avrare_is_cheap():
    loaded = loaded_by("import avrare")
    assert not loaded & {"numpy", "pydantic", "pluggy", "rich", "lark", "yaml"}
    table = {"avrare.base", "avrare.base.renderers", "avrare.output", "avrare.output.renderers"}
    assert {name for name in loaded if name.startswith("avrare")} == {"avrare", *table}


def test_monte_carlo_and_splitting_import_nothing_heavy():
    code = """
import numpy as np, avrare
class Walk:
    noise_size = 1
    def initial(self, noise): return {"x": np.zeros(len(noise))}
    def step(self, state, noise): return {"x": state["x"] + noise[:, 0]}
    def signals(self, state): return state
problem = avrare.Problem(Walk(), avrare.stl("always (x < 2)"), steps=5)
for name in ("mc", "ams"): avrare.estimate(problem, name)
"""
    assert not {name.split(".")[0] for name in loaded_by(code)} & HEAVY


def test_describing_plugins_imports_nothing_heavy():
    code = """
from avrare.plugin.registry import default_registry
for row in default_registry().rows(): row.component.load_config()
"""
    loaded = loaded_by(code)
    assert "avrare_estimators" in loaded
    assert not {name.split(".")[0] for name in loaded} & HEAVY
