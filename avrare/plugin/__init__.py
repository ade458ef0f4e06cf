"""Plugin interface: descriptions of components, and the registry that finds them."""

from avrare.plugin.component import KINDS, Component, Finding, RuleCard, RuleParameter, hookimpl
from avrare.plugin.option_marks import Drawable

__all__ = ["KINDS", "Component", "Drawable", "Finding", "RuleCard", "RuleParameter", "hookimpl"]
