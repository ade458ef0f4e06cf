"""Conformance checks of plugin components, as ``avrare plugins --check`` runs them."""

from avrare.testing.conformance.suite import Check, Outcome, Subject, checks_of, examine

__all__ = ["Check", "Outcome", "Subject", "checks_of", "examine"]
