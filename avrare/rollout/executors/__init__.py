"""Executors: where chunks of rollouts run."""
