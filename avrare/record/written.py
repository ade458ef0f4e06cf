"""result.json and the other JSON files of a run's folder, read back."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from avrare.errors import UsageError


def read_result(path: Path) -> dict[str, Any]:
    """The content of a run's result.json.

    Raises:
        UsageError: There is none, or it is damaged.
    """
    file = path / "result.json"
    if not file.is_file():
        inside = sorted(one.parent.name for one in path.glob("*/result.json")) if path.is_dir() else []
        hint = f"it holds several runs; give one of them: {', '.join(inside)}" if inside else None
        unfinished = "it is not finished: avrare run --resume goes on with it"
        if (path / "checkpoint").is_dir():
            hint = unfinished
        raise UsageError(
            f"{path}: no result.json in it", hint or "give the folder that `avrare run --out` has written"
        )
    content = read_json(file)
    if not {"scenario", "estimates", "fingerprint", "seed", "versions"} <= set(content):
        raise UsageError(f"{file}: this is no result of avrare run", "run the scenario again")
    return content


def written_at(path: Path) -> datetime:
    """When a run's result was written: as its provenance says, else when the file was last changed."""
    origin = path / "provenance.json"
    date = read_json(origin).get("date") if origin.is_file() else None
    try:
        return datetime.fromisoformat(str(date)).astimezone(UTC)
    except ValueError:
        return datetime.fromtimestamp((path / "result.json").stat().st_mtime, UTC)


def read_json(path: Path) -> dict[str, Any]:
    """A file that holds a JSON object.

    Raises:
        UsageError: It cannot be read, or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be read: {error}", "run the scenario again") from None
    if not isinstance(content, dict):
        raise UsageError(f"{path}: this is no JSON object", "run the scenario again")
    return content
