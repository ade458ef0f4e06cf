"""Perception error models as a rollout evaluates them: NumPy only."""
