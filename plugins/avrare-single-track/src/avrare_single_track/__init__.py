"""Kinematic single-track driving simulator on a straight multi-lane road."""
