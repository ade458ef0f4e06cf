"""Stored failures: database, replay, shrinking and search."""

FAILURES_FOLDER = ".avrare/failures"
"""Default folder of stored failures."""
