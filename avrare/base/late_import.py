"""Late import of objects that the description of a component names."""

from __future__ import annotations

import importlib
from typing import Any


def late_import(reference: str) -> Any:
    """Import ``package.module:name`` and return it."""
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)
