"""Conformance checks of plugin components, as ``avrare check-plugin`` runs them."""

from avrare.testing.conformance.check_outcome import Check, Outcome
from avrare.testing.conformance.component_under_test import Subject
from avrare.testing.conformance.suite import checks_of, examine

__all__ = ["Check", "Outcome", "Subject", "checks_of", "examine"]
