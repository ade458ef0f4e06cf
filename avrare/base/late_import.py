"""Late import of what only some callers need, or of what lies in a later room."""

from __future__ import annotations

import importlib
from typing import Any


def late_import(reference: str) -> Any:
    """Import ``package.module:name`` and return it."""
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)
