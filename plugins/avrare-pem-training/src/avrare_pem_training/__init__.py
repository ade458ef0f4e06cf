"""Training of perception error models on the output of a detector: ``avrare pem fit``."""
