"""The loop that drives an estimator, its pace and its checkpoints."""
