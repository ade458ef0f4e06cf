"""``avrare schema``: JSON schema of scenario files, for editors."""

from __future__ import annotations

import argparse
import json

from avrare.plugin.registry import default_registry
from avrare.scenario.json_schema import scenario_schema


def execute(args: argparse.Namespace) -> None:
    """Print the schema with the options of every installed component."""
    print(json.dumps(scenario_schema(default_registry()), indent=2))
