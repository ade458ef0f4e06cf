"""Which part of a scenario is the question, and which is the stack that is asked.

Two estimates of a rule can be compared if the world, what is perceived of it, the length of a drive and the
rule are the same. Everything else may differ: the tracker and the controller are what is tested; the
estimator, its seed and its budget only decide how exact the answer is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

SHARED = ("steps", "simulator", "perception")
"""Keys of a resolved scenario that define the question for every rule."""
_MOST = 5
"""Differences that are told."""


def differences(old: Mapping[str, Any], new: Mapping[str, Any], rules: list[str]) -> list[str]:
    """How two resolved scenarios ask another question, as ``simulator.dt 0.1 -> 0.05``; empty: the same.

    Args:
        old: Of the baseline.
        new: Of this run.
        rules: Specifications that are to be compared; what only one scenario has is no difference.
    """
    found = [line for key in SHARED for line in _between(key, old.get(key), new.get(key))]
    rules_of = [one.get("specifications", {}) for one in (old, new)]
    for name in rules:
        if all(name in one for one in rules_of):
            found += _between(f"specifications.{name}", *(one[name] for one in rules_of))
    return found


def told(lines: list[str]) -> str:
    """The first few differences on one line."""
    more = len(lines) - _MOST
    return ", ".join(lines[:_MOST]) + (f", and {more} more" if more > 0 else "")


def _between(path: str, old: Any, new: Any) -> Iterator[str]:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        if old.get("plugin") != new.get("plugin"):  # their options have nothing in common
            yield f"{path}.plugin {_short(old.get('plugin'))} -> {_short(new.get('plugin'))}"
            return
        for key in [*old, *(key for key in new if key not in old)]:
            # A score orders particles for the estimator: it is no part of the rule.
            if not (path.startswith("specifications.") and key == "score"):
                yield from _between(f"{path}.{key}", old.get(key), new.get(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (one, two) in enumerate(zip(old, new, strict=True)):
            yield from _between(f"{path}.{index}", one, two)
    elif old != new:
        yield f"{path} {_short(old)} -> {_short(new)}"


def _short(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, Mapping):
        return str(value.get("plugin", "{...}"))
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
