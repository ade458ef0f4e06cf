"""Command of this distribution: ``avrare monitor``."""
