"""Forty problems like those of driving stacks, with exact answers, written without a look at an estimator."""
