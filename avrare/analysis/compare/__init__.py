"""Comparisons: estimators on one problem, or two versions of a stack on the same noise."""
