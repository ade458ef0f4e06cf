"""Rates of rule violations per hour and per km, over a catalogue of scenes with exposures."""
