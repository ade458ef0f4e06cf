"""Recorded drives under a specification: robustness over time and its causes."""
