"""Rare-event estimators: adaptive multilevel splitting."""
