"""Plugin interface: descriptions of components, and the registry that finds them."""

from avrare.plugin.component import KINDS, Component, Finding, RuleCard, RuleParameter, hookimpl

__all__ = ["KINDS", "Component", "Finding", "RuleCard", "RuleParameter", "hookimpl"]
