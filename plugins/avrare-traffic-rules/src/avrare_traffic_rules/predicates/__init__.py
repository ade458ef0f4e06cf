"""The predicates by what they speak of: places on the road, motion, distances that keep safe."""
