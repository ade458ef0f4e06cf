"""Semantics of formulas on complete traces."""
