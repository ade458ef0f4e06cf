"""Estimators side by side: the same problem, the same budget, many repetitions."""
