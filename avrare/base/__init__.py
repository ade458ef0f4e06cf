"""Foundations that know nothing of the domain: batches, errors, files, number formats."""
