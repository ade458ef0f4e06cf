"""Scenarios of this project as plain data, and plain data as YAML text."""

import copy
import functools
import json

import yaml

from attack.material import ROOT
from attack.mutation import places
from avrare.scenario import yaml as scenario_yaml
from avrare.scenario.extends import read


@functools.cache
def scenarios() -> dict[str, dict]:
    """Return the scenarios of this project as plain data, by name."""
    return {path.stem: read(str(path)).plain() for path in sorted((ROOT / "scenarios").glob("*.yaml"))}


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):
    yaml_implicit_resolvers = scenario_yaml._Dumper.yaml_implicit_resolvers


@functools.cache
def _loaded(text):
    return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


def as_tree(text):
    return copy.deepcopy(_loaded(text))


def as_text(tree) -> bytes:
    try:  # as the product writes it, ten times as fast
        text = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)
        return text.encode("utf-8", "surrogatepass")
    except Exception:  # what this writer does not write is JSON, which is YAML
        return json.dumps(tree).encode()


_MOST = {"steps": 30, "rollouts": 40, "particles": 20, "chains": 10, "runs": 3, "chunk": 1000}


def reduce_sizes(tree):
    """Lower the sizes to what a machine can compute in a second; large ones have tests of their own."""
    for parent, key in places(tree):
        most = _MOST.get(key) if isinstance(parent, dict) else None
        if most is not None and type(parent[key]) in (int, float) and parent[key] > most:
            parent[key] = most
    return tree
