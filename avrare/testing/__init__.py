"""Testing kit: problems of known failure probability, and a conformance suite for estimators.

``avrare.testing.problems`` holds the reference problems and generators of more of them;
``avrare.testing.faulty_systems`` small systems that raise, report faults, count, ...;
``avrare.testing.estimators`` the conformance suite, the one module here that needs pytest.
"""
