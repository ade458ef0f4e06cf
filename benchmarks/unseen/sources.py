"""Digest of the code that the numbers of an estimator come from."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from avrare.plugin.registry import default_registry

LIBRARIES = ("avrare.estimation", "avrare_")
"""Beginnings of the names of modules that count."""


@cache
def digest_of(estimator: str) -> str:
    """Return a digest of the modules of an estimator and of all that they import; comments do not count.

    Those of all that ``auto`` may choose are among its own.
    """
    components = [default_registry().find("estimator", estimator).component]
    if estimator == "auto":
        components += [component for component, _ in default_registry().candidates()]
    waiting = [component.factory.partition(":")[0] for component in components if component is not None]
    codes: dict[str, str] = {}
    while waiting:
        name = waiting.pop()
        if name not in codes and (path := _find_source(name)):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            waiting += _list_imports(tree)
            codes[name] = ast.dump(_without_docstrings(tree))
    return hashlib.sha256("\n".join(codes[name] for name in sorted(codes)).encode()).hexdigest()[:10]


def _find_source(name: str) -> Path | None:
    """Return the file of a module that counts; None for other modules and for names in a module."""
    if not name.startswith(LIBRARIES):
        return None
    try:
        spec = find_spec(name)
    except ModuleNotFoundError:
        return None
    return Path(spec.origin) if spec and spec.origin else None


def _list_imports(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [entry for entry in node.body if not _is_text(entry)]
    return tree


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
