"""The version of avrare."""

__version__ = "0.1.0"
