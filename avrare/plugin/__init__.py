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
from avrare.plugin.options import Options

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
