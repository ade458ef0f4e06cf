"""Estimators, intervals, health, and the loop that drives them."""
