"""Markov kernels of elliptical slice sampling, except for the common one of Crank-Nicolson steps."""
