"""Presentation of results: terminal, plots, documents, HTML."""
