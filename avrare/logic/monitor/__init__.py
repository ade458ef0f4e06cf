"""Monitors: formulas followed one sample at a time."""
