"""Recorded drives: CSV and CommonRoad files, and stored failures driven again."""
