"""The testing kit: problems whose failure probability is known, and a suite that any estimator can run.

``avrare.testing.problems`` holds the reference problems, with generators for more of their kind;
``avrare.testing.systems`` small awkward systems (breaking down, raising, counting, ...);
``avrare.testing.estimators`` the conformance suite, the one module here that needs pytest.
"""
