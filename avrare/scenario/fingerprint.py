"""One short hash that two runs share when their results may be compared."""

from __future__ import annotations

import hashlib
import json

from avrare.scenario.files import digests
from avrare.scenario.schema import Scenario


def fingerprint(scenario: Scenario) -> str:
    """16 hexadecimal digits of the resolved scenario, its plugins' versions and the files it names.

    Everything counts, defaults included, except the seed; the number of workers and the executor are no part
    of a scenario.
    """
    resolved = {key: value for key, value in scenario.resolved.items() if key != "seed"}
    content = {"scenario": resolved, "versions": scenario.versions}
    if files := digests(scenario):
        content["files"] = files
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:16]
