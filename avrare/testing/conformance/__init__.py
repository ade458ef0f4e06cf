"""Conformance checks of plugin components, as ``avrare check-plugin`` runs them."""

from avrare.testing.conformance.suite import Check, Outcome, Subject, checks_of, examine

__all__ = ["Check", "Outcome", "Subject", "checks_of", "examine"]
