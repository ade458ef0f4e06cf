"""Perception error models: Gaussian processes fitted to a lidar detector, and a parametric one."""
