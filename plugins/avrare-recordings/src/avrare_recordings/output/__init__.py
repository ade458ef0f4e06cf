"""Texts and files of monitored drives."""
