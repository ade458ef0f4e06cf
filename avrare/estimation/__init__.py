"""Estimation: the loop, Monte Carlo, intervals, health warnings and results."""
