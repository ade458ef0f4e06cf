"""Adaptive multilevel splitting (stl-ams)."""
