"""Plugins: what the core knows of parts that it never imports."""

from avrare.plugin.component import KINDS, Component
from avrare.plugin.hookspecs import hookimpl

__all__ = ["KINDS", "Component", "hookimpl"]
