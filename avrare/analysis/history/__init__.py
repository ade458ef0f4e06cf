"""Estimates over commits, kept in a database."""
