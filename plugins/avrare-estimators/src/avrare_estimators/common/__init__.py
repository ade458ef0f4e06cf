"""Parts that more than one estimator stands on; nothing here knows an estimator."""
