"""Intervals from several estimates: cross-checks and ensembles of models."""
