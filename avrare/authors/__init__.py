"""For authors of plugins: a complete package to begin with, and checks of what it has to keep to."""

from avrare.authors.outcome import Check, Outcome
from avrare.authors.subject import Subject
from avrare.authors.suite import checks_of, examine

__all__ = ["Check", "Outcome", "Subject", "checks_of", "examine"]
