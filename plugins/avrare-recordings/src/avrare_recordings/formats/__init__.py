"""Formats of recorded drives: CSV, CommonRoad, highD and inD, MCAP, Rerun."""
