"""Parts that the programs in benchmarks/ share."""
