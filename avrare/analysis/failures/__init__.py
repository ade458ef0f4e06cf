"""Stored failures: database, replay, shrinking, search and clustering."""
