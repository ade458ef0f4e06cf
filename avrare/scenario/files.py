"""The files that options name: what is in them is part of what a scenario says."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from avrare.scenario.schema import Block, Scenario

MARK = "file"
"""An option whose value may be the path of a file says ``Field(..., json_schema_extra={"file": True})``."""


def digests(scenario: Scenario) -> dict[str, str]:
    """Dotted path of each option that names an existing file -> 16 digits of its content's hash.

    Raises:
        OSError: A file cannot be read.
    """
    return {
        f"{key}.{name}": hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for key, block in scenario.blocks.items()
        for name, path in _files(block)
    }


def changes(before: Mapping[str, str], after: Mapping[str, str], keys: tuple[str, ...]) -> list[str]:
    """Options below one of ``keys`` whose file has other content than before, one line each."""
    both = [path for path in before if path in after and path.startswith(tuple(f"{key}." for key in keys))]
    return [f"{path}: its file has changed" for path in both if before[path] != after[path]]


def _files(block: Block) -> Iterator[tuple[str, Path]]:
    for name, field in type(block.config).model_fields.items():
        extra, value = field.json_schema_extra, getattr(block.config, name)
        marked = isinstance(extra, dict) and extra.get(MARK)
        if marked and isinstance(value, str | Path) and Path(value).is_file():
            yield name, Path(value)
