"""Recorded drives: their formats and roads, and monitoring under a specification."""
