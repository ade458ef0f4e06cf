"""Plugin interface: descriptions of components, and the registry that finds them."""

from avrare.plugin.component import (
    KINDS,
    AutoRole,
    CheckRole,
    Component,
    Finding,
    RuleCard,
    RuleParameter,
    hookimpl,
)
from avrare.plugin.options import Drawable, Options

__all__ = [
    "KINDS",
    "AutoRole",
    "CheckRole",
    "Component",
    "Drawable",
    "Finding",
    "Options",
    "RuleCard",
    "RuleParameter",
    "hookimpl",
]
