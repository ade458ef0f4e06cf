"""Estimates over commits: a store of results, a table and a picture of how they went."""
