"""Plugins: what the core knows of parts that it never imports."""

from avrare.plugin.component import KINDS, Component
from avrare.plugin.finding import Finding
from avrare.plugin.hookspecs import hookimpl
from avrare.plugin.rulecard import RuleCard, RuleParameter

__all__ = ["KINDS", "Component", "Finding", "RuleCard", "RuleParameter", "hookimpl"]
