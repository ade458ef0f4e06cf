"""Fingerprint of a scenario: results are comparable if their fingerprints are equal."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from avrare.plugin.options import FILE, Options, is_marked
from avrare.scenario.schema import Scenario


def fingerprint(scenario: Scenario) -> str:
    """Return 16 hexadecimal digits of the resolved scenario, its plugins' versions and the files it names.

    Defaults count; seed, exposure and the tags that only evidence reads do not. The number of workers and the
    executor are not part of a scenario, nor is the size of a chunk that it does not name.
    """
    not_counted = ("seed", "exposure", "requirements", "odd", "objective")
    resolved = {key: value for key, value in comparable(scenario).items() if key not in not_counted}
    if resolved["estimator"].get("memory", 0) is None:  # only a given one may change how work is divided
        del resolved["estimator"]["memory"]
    content = {"scenario": resolved, "versions": scenario.versions}
    if files := digests(scenario):
        content["files"] = files
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]


def comparable(scenario: Scenario) -> dict[str, Any]:
    """Return the resolved scenario with the files that its options name, but without their folders.

    So a scenario that is called from another folder is the same; ``digests`` compares the files.
    """
    plain: dict[str, Any] = dict(scenario.resolved)
    for key, block in scenario.blocks.items():
        kind, _, name = key.partition(".")
        _leave_folders_out(block.config, plain[kind][name] if name else plain[kind])
    for part, block in scenario.cheap.blocks.items() if scenario.cheap is not None else ():
        if part in plain["cheap"]:
            _leave_folders_out(block.config, plain["cheap"][part])
    return plain


def identify(scenario: Scenario) -> dict[str, Any]:
    """Return all that must be equal to resume rollouts of a scenario, the telling parts first."""
    return {**comparable(scenario), "versions": scenario.versions, "fingerprint": fingerprint(scenario)}


def _leave_folders_out(config: BaseModel, options: dict[str, Any]) -> None:
    for name, field in type(config).model_fields.items():
        value, key = getattr(config, name), field.alias or name
        if is_marked(field, FILE) and is_file(value):
            options[key] = Path(value).name
        elif isinstance(value, BaseModel) and isinstance(options.get(key), dict):
            _leave_folders_out(value, options[key])


def digests(scenario: Scenario) -> dict[str, str]:
    """Return, for each option that names an existing file, its dotted path and 16 digits of the file's hash.

    Raises:
        OSError: A file cannot be read.
    """
    return {
        f"{key}.{name}": hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for key, config in list_options(scenario)
        for name, path in named_files(config)
    }


def list_options(scenario: Scenario, prefix: str = "") -> Iterator[tuple[str, Options]]:
    """Yield (dotted path, options) of all components, with those of a cheap variant and of an ensemble."""
    for key, block in scenario.blocks.items():
        yield f"{prefix}{key}", block.config
    variants = {"cheap": scenario.cheap} if scenario.cheap is not None else {}
    variants |= {f"ensemble.{number}": member for number, member in enumerate(scenario.members)}
    for name, variant in variants.items():
        yield from list_options(variant, f"{prefix}{name}.")


def named_files(config: Options) -> Iterator[tuple[str, Path]]:
    """Yield (dotted path, file) of the options that name an existing file."""
    yield from _marked_files(config)
    yield from config.used_files().items()


def _marked_files(config: BaseModel) -> Iterator[tuple[str, Path]]:
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if is_marked(field, FILE) and is_file(value):
            yield name, Path(value)
        elif isinstance(value, BaseModel):
            yield from ((f"{name}.{inner}", path) for inner, path in _marked_files(value))


def is_file(value: object) -> bool:
    """Return whether a value is the path of a file."""
    try:
        return isinstance(value, str | Path) and Path(value).is_file()
    except (OSError, ValueError):  # too long, or a NUL in it
        return False


def changed_files(before: Mapping[str, str], after: Mapping[str, str], keys: tuple[str, ...]) -> list[str]:
    """Return a line for each option below one of ``keys`` whose file has changed between two digests."""
    both = [path for path in before if path in after and path.startswith(tuple(f"{key}." for key in keys))]
    return [f"{path}: its file has changed" for path in both if before[path] != after[path]]
