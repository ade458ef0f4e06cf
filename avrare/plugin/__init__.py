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
from avrare.plugin.option_marks import Drawable

__all__ = [
    "KINDS",
    "AutoRole",
    "CheckRole",
    "Component",
    "Drawable",
    "Finding",
    "RuleCard",
    "RuleParameter",
    "hookimpl",
]
