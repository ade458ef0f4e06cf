"""Checks after sampling: probes for failures that the scores do not lead to."""
