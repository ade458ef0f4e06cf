"""The cross-entropy method."""
