"""A run's folder as one HTML file that needs nothing else."""
