"""Interacting-multiple-model tracker for highway traffic, batched over particles and vehicles."""
