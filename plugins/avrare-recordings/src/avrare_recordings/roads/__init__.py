"""Roads of recorded drives, from their lanelets, and the ways through intersections."""
