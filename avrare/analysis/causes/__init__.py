"""Causes of failures: their kinds, what carries them, what changes them, and how good a part must be."""
