"""The estimator `auto`: which method, with which share of the budget."""
