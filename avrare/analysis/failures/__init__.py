"""Stored failures: database, replay, shrinking and search."""
