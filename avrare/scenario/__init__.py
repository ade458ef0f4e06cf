"""Scenario files: from YAML text to a checked ``Scenario``; mistakes are reported with their position."""
