"""Learned probability of a failure from the features of a state."""
