"""The version of avrare."""

__version__ = "1.0.0"
