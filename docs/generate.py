"""The reference pages, made of the code: argparse's options, pydantic's models, the plugins' descriptions.

MkDocs calls the hooks when it builds the site; ``python docs/generate.py DIR`` writes the pages to a folder.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_NOTEBOOKS = Path(__file__).parent / "notebooks"
_RULE_PICTURES = Path(__file__).parent / "rules"
_PLUGIN_LINK = re.compile(r"\[([^\]]*)\]\(\.\./plugins/[^)]*\)")
"""A link out of the documentation, into the source: plain words on the site."""


def pages() -> dict[str, str]:
    """Return path below ``docs/`` -> Markdown of every reference page."""
    return {
        "reference/cli.md": _commands(),
        "reference/scenario.md": _scenario(),
        "reference/components.md": _components(),
        "reference/rules.md": _rules(),
        "reference/python.md": _python(),
        **{f"notebooks/{path.stem}.md": _notebook(path) for path in sorted(_NOTEBOOKS.glob("*.ipynb"))},
    }


def on_files(files: Any, config: Any) -> Any:
    """Hand the pages to MkDocs."""
    from mkdocs.structure.files import File

    for path, text in pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Leave out links to files that are no part of the site."""
    return _PLUGIN_LINK.sub(r"\1", markdown)


def _commands() -> str:
    from avrare.base.errors import AvrareError, ExitCode
    from avrare.cli.main import COMMANDS, PROVIDED, command_parser

    parts = ["# Command line", "Every option of every command. `avrare COMMAND --help` prints the same."]
    for name, (_, summary) in (COMMANDS | PROVIDED).items():
        try:
            parser = command_parser(name)
        except AvrareError:
            continue  # its plugin is not installed
        parts += [f"## avrare {name}", f"{summary.capitalize()}.", *_parser(parser)]
    rows = [(f"`{code.value}`", code.name.lower().replace("_", " ")) for code in ExitCode]
    return _page([*parts, "## Exit codes", _table(("code", "meaning"), rows)])


def _parser(parser: argparse.ArgumentParser) -> list[str]:
    usage = " ".join(parser.format_usage().removeprefix("usage: ").split())
    rows = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            continue
        words = ", ".join(action.option_strings) or str(action.metavar or action.dest)
        value = (
            f" {action.metavar or action.dest.upper()}" if action.option_strings and action.nargs != 0 else ""
        )
        rows.append((f"`{words}{value}`", (action.help or "") % vars(action) if action.help else ""))
    parts = [f"```text\n{usage}\n```", _table(("argument", "what it does"), rows)]
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                parts += [f"### {parser.prog} {name}", *_parser(inner)]
    return parts


def _scenario() -> str:
    from avrare.plugin.registry import Registry
    from avrare.scenario.json_schema import scenario_schema

    schema = scenario_schema(Registry())  # no plugins: their options are on a page of their own
    parts = [
        "# Scenario files",
        "One YAML file: which parts, their options, the rules. An unknown key is an error with a hint. "
        "`avrare validate --schema` prints the JSON schema for editors, `avrare validate` checks a file.",
        "## Keys",
        _options(schema, ("extends",), _PARTS),
    ]
    for title, name in (
        ("thresholds", "Threshold"),
        ("regression", "Regression"),
        ("cross_check", "CrossCheck"),
    ):
        parts += [f"## {title}", _options(schema["$defs"][name])]
    from avrare.scenario.schema import Formula

    parts += ["## A specification that is a formula", _options(Formula.model_json_schema())]
    return _page(parts)


def _components() -> str:
    from avrare.plugin.registry import default_registry

    parts = ["# Components", "Components that a scenario names with `plugin:`, and their options."]
    kind = ""
    for row in default_registry().rows():
        if row.component is None:
            continue
        if row.kind != kind:
            kind = row.kind
            parts.append(f"## {kind.capitalize()}s" if kind != "perception" else "## Perception")
        parts += [
            f"### {row.name}",
            f"{row.summary[:1].upper()}{row.summary[1:]}. From `{row.distribution}`.",
        ]
        schema = row.component.load_config().model_json_schema()
        parts.append(_options(schema))
        for name, inner in schema.get("$defs", {}).items():
            if inner.get("properties"):
                parts += [f"*{name}*", _options(inner)]
    return _page(parts)


def _rules() -> str:
    from avrare.plugin.registry import default_registry
    from avrare.plugin.rule_catalogue import Catalogue
    from avrare_traffic_rules.definitions import RECOMMENDED

    parts = [
        "# Every rule",
        "Each rule in words, as a formula, with its options and in pictures; "
        "[Traffic rules](../traffic-rules.md) says how they are read. `avrare rules NAME` prints the same.",
    ]
    for card in (offer.card for offer in Catalogue.of(default_registry()).offers):
        options = [
            (f"`{option.name}`", option.default, option.unit, option.text, option.source)
            for option in card.parameters
        ]
        parts += [f"## {card.name}: {card.title}", card.text, f"```\n{card.formula}\n```", card.remarks]
        parts += [_table(("option", "default", "unit", "meaning", "source"), options)] if options else []
        parts.append(f"Source: {card.source}.")
        if (_RULE_PICTURES / f"{card.name}.png").exists():
            parts.append(f"![Situations of {card.name}](../rules/{card.name}.png)")
    predicates = [
        (f"`{name}({', '.join(predicate.arguments)})`", predicate.text, predicate.unit, predicate.scale)
        for name, predicate in RECOMMENDED.predicates.items()
    ]
    heads = ("predicate", "true if, or value", "unit", "divided by the scale")
    return _page([*parts, "## Predicates", _table(heads, predicates)])


def _python() -> str:
    import avrare

    parts = ["# Python", "What `import avrare` offers; [Work in Python](../python.md) shows how to use it."]
    modules = avrare.find_modules()
    for name in sorted(modules, key=lambda name: (not name[0].islower(), name)):
        if not name.startswith("_"):
            parts.append(f"::: {modules[name]}.{name}")
    parts.append("::: avrare.rollout.replay.Trace")
    return _page(parts)


def _notebook(path: Path) -> str:
    """Return a notebook with its stored outputs as a page."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f'<img alt="plot" src="data:image/png;base64,{data["image/png"]}">')
            elif "text/html" in data:
                parts.append("".join(data["text/html"]))
            else:
                text = "".join(output.get("text") or data["text/plain"])
                parts.append(f"```text\n{text}\n```")
    parts.insert(1, f"[Download this notebook]({path.name})")
    return _page(parts)


_PARTS = {
    name: f"block: `{{plugin: NAME}}` and the options of one of the [{text}](components.md#{anchor})"
    for name, text, anchor in (
        ("simulator", "simulators", "simulators"),
        ("perception", "perception error models", "perception"),
        ("tracker", "trackers", "trackers"),
        ("controller", "controllers", "controllers"),
        ("estimator", "estimators", "estimators"),
    )
}
"""Type of the keys whose options are a plugin's."""


def _options(
    schema: dict[str, Any], first: tuple[str, ...] = (), types: Mapping[str, str] | None = None
) -> str:
    """Return the properties of a JSON schema as a table, required ones first; ``types`` of some are given."""
    required = {*schema.get("required", []), *(schema.get("anyOf", [{}])[-1].get("required", []))}
    properties = schema.get("properties", {})
    if not properties:
        return "No options."
    order = sorted(properties, key=lambda name: (name not in first, name not in required))
    rows = []
    for name in order:
        part = properties[name]
        default = "required" if name in required else _value(part["default"]) if "default" in part else ""
        rows.append(
            (f"`{name}`", (types or {}).get(name) or _type(part), default, part.get("description", ""))
        )
    return _table(("key", "type", "default", "meaning"), rows)


def _type(part: dict[str, Any]) -> str:
    if "enum" in part:
        return ", ".join(f"`{value}`" for value in part["enum"])
    if "$ref" in part:
        return f"*{part['$ref'].rpartition('/')[2]}*"
    choices = part.get("anyOf") or part.get("oneOf") or part.get("allOf")
    if choices:
        words = dict.fromkeys(_type(choice) for choice in choices)
        return " or ".join(words) if len(words) <= 4 else "block"
    if part.get("type") == "array":
        return f"list of {_type(part['items'])}" if "items" in part else "list"
    return {"object": "mapping", "string": "text", "integer": "integer", "null": "null"}.get(
        part.get("type", ""), part.get("type", "any")
    )


def _value(value: object) -> str:
    text = str(value)
    return f"`{text}`" if text and len(text) <= 40 else "..." if text else ""


def _table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [heads, ("---",) * len(heads), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _page(parts: list[str]) -> str:
    return "\n\n".join(filter(None, parts)) + "\n"


if __name__ == "__main__":
    for place, content in pages().items():
        target = Path(sys.argv[1]) / place
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(content, encoding="utf-8")
