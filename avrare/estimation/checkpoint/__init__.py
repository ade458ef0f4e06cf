"""Checkpoints: the outcome of every finished chunk, from which an estimate resumes."""
