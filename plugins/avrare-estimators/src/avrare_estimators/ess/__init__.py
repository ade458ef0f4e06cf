"""Elliptical slice sampling with nested levels (stl-ess)."""
