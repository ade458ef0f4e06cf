"""Scenario files: from YAML text to a checked ``Scenario``, with every mistake named by its place."""
