"""Comparisons: estimators on one problem, or two versions of a stack on the same noise."""

REPEAT = 10
"""Default number of estimates of each estimator."""
