"""Failures that can be kept: stored, replayed elsewhere, shrunk, searched for and sorted into kinds."""
