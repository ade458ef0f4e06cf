"""Markov kernels of elliptical slice sampling, but for the common one of Crank-Nicolson steps."""
