"""JSON schema of scenario files: the core's model and the options of every component."""

from __future__ import annotations

from typing import Any

from avrare.plugin.registry import Registry, Row
from avrare.scenario.schema import PARTS, Document, Formula

Schema = dict[str, Any]


def scenario_schema(registry: Registry) -> Schema:
    """Return the draft 2020-12 schema of a scenario; a component whose model fails to import is left out."""
    schema = Document.model_json_schema()
    definitions: Schema = schema.setdefault("$defs", {})
    properties: Schema = schema["properties"]
    for kind in PARTS:
        choices = _choices(registry, kind, definitions)
        if kind in ("perception", "tracker", "controller"):
            choices.append({"type": "null"})
        properties[kind] = {"description": properties[kind]["description"], "oneOf": choices}
    properties["suppress"]["items"]["enum"] = sorted(registry.warnings().keys() - {"errors"})
    checkers = [checker.name for checker in registry.checkers()]
    definitions["CrossCheck"]["properties"]["estimator"]["anyOf"][0]["enum"] = checkers
    formula = Formula.model_json_schema()
    choices = [formula, *_choices(registry, "specification", definitions)]
    properties["specifications"]["additionalProperties"] = {"oneOf": choices}
    text = "scenario file, relative to this one, whose keys this one inherits"
    properties["extends"] = {"type": "string", "description": text}
    required = schema.pop("required")
    schema["anyOf"] = [{"required": ["extends"]}, {"required": required}]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _choices(registry: Registry, kind: str, definitions: Schema) -> list[Schema]:
    rows = [row for row in registry.rows() if row.kind == kind and row.status in ("ok", "missing dependency")]
    return [choice for row in rows if (choice := _choice(row, definitions))]


def _choice(row: Row, definitions: Schema) -> Schema | None:
    """Return the schema of one component's block; its definitions move to ``definitions`` with a prefix."""
    assert row.component is not None
    prefix = f"{row.kind}.{row.name}."
    try:
        options = row.component.load_config().model_json_schema(ref_template=f"#/$defs/{prefix}{{model}}")
    except Exception:
        return None
    definitions.update({prefix + name: part for name, part in options.pop("$defs", {}).items()})
    plugin: Schema = {"plugin": {"const": row.name, "description": row.summary}}
    if row.kind == "estimator":
        text = "names of the specifications to estimate; default all"
        names = {"type": "array", "items": {"type": "string"}, "minItems": 1, "description": text}
        plugin["specifications"] = names
    options["properties"] = plugin | options.get("properties", {})
    options["required"] = ["plugin", *options.get("required", [])]
    return dict(options)
