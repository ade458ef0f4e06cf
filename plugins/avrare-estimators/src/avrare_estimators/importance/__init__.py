"""Importance sampling and the cross-entropy method."""
