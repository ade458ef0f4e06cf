"""The structure of the room: no circular imports, and no text is parsed twice."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

from avrare.logic import stl
from avrare.logic.syntax import parser

ROOM = Path(parser.__file__).parents[1]


def imports(path):
    """Return modules of the room that a module imports, also inside functions and under TYPE_CHECKING."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("avrare.logic."):
            named = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if (file_of(name)).exists() else node.module for name in named)


def file_of(name):
    return ROOM.joinpath(*name.split(".")[2:]).with_suffix(".py")


def test_no_import_is_circular_even_in_types():
    modules = [path for path in ROOM.rglob("*.py") if path.name != "__init__.py"]
    graph = {path: {file_of(name) for name in imports(path)} for path in modules}
    order = list(TopologicalSorter(graph).static_order())  # raises CycleError
    assert set(order) == set(modules)
    assert order.index(ROOM / "monitor" / "monitors.py") < order.index(ROOM / "formula.py")


def test_a_text_is_parsed_once_in_a_process():
    text = "always[0:3s] (parsed_once < 4)"
    before = parser._parse.cache_info().misses
    formulas = [stl(text, dt=0.1), stl(text, dt=0.1, until="half-open"), stl(text, dt=0.1, warn=False)]
    assert parser._parse.cache_info().misses == before + 1
    assert formulas[0].node is formulas[2].node
    assert stl(text, dt=0.5).node != formulas[0].node
