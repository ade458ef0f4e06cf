"""Weighted samples: drawn, cross-checked, summed up; the sampler that `is` and `ce` extend."""
