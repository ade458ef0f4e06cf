"""Importance scores, which order the particles in splitting."""
