"""Fitting a perception error model to a detector's output; needs the ``train`` extra."""
