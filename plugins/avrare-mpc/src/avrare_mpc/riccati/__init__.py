"""The same programme for many particles at once: a structured interior-point method, compiled by numba."""
