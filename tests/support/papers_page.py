"""Commands, names and links of docs/papers.md that lead nowhere."""

import argparse
import importlib
import re
import runpy
import shlex
import sys
from functools import cache
from pathlib import Path

import pytest
from markdown import Markdown

from avrare.base.errors import AvrareError
from avrare.cli.main import COMMANDS, PROVIDED, command_parser
from avrare.plugin.registry import default_registry
from avrare.scenario.load import load
from avrare.testing.problems import reference_problem
from avrare_traffic_rules.catalogue import rules

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "papers.md"
SCENE = ROOT / "scenarios" / "lane_change_paper.yaml"
COMPONENTS = [row.component for row in default_registry().rows() if row.component is not None]


def find_mistakes(text):
    """Return what leads nowhere in a text of the page; the last cell of a row has whole commands."""
    checks = [(check_link, target) for target in re.findall(r"\]\(([^)]+)\)", text)]
    for line in text.splitlines():
        last_cell = line.rstrip(" |").rpartition(" | ")[2]
        for span in re.findall(r"`([^`]+)`", line):
            check = check_command if f"`{span}`" in last_cell else check_mention
            checks.append((check if re.match("(avrare|python|pytest) ", span) else check_name, span))
    mistakes = []
    for check, subject in checks:
        try:
            check(subject)
        except (AssertionError, AvrareError, AttributeError, KeyError, OSError, SystemExit) as error:
            mistakes.append(f"{subject}: {error!r}")
    return mistakes


def check_link(target):
    page, _, anchor = target.partition("#")
    document = Markdown(extensions=["toc", "tables", "fenced_code"])
    document.convert((PAGE.parent / (page or PAGE.name)).read_text(encoding="utf-8"))
    assert not anchor or f"'id': '{anchor}'" in repr(document.toc_tokens), "no heading has this anchor"


def check_command(command):
    for part in command.split(" && "):
        program, *words = shlex.split(part)
        if program == "pytest":
            assert all((ROOT / path).exists() for path in words), "there is no such test"
        elif words[-1] == "--help":
            command_parser(words[0])
        else:
            (check_avrare if program == "avrare" else check_python)(words)


def check_python(words):
    parse_args = argparse.ArgumentParser.parse_args

    def stop_after_parsing(*arguments):
        parse_args(*arguments)
        raise InterruptedError

    if words[0] == "-c":
        compile(words[1], "-c", "exec")
    elif "parse_args" not in (ROOT / words[0]).read_text(encoding="utf-8"):
        assert not words[1:], "it takes no arguments"
    else:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", words)
            patch.setattr(argparse.ArgumentParser, "parse_args", stop_after_parsing)
            with pytest.raises(InterruptedError):
                runpy.run_path(str(ROOT / words[0]), run_name="__main__")


def check_avrare(words):
    given = vars(command_parser(words[0]).parse_args(words[1:]))
    for name in filter(None, (given.get("estimators") or "").split(",")):
        check_name(name)
    for path in given.get("scenarios") or filter(None, [given.get("scenario")]):
        if path.startswith("problem:"):
            reference_problem(path.removeprefix("problem:"))
            continue
        scenario = load(ROOT / path, given.get("set") or [], given.get("estimator"))
        assert given.get("specification") in (None, *scenario.specifications)
        for parameter in given.get("parameter") or []:
            block, dot, option = parameter.partition(".")
            assert not dot or option in scenario.resolved[block], "there is no such parameter"


def check_mention(command):
    _, name, *words = shlex.split(command)
    assert {word for word in words if word[0] == "-"} <= options_of(name), "there is no such option"


def check_name(name):
    option, separator, value = re.fullmatch(r"(.*?)(: |=|$)(.*)", name).groups()
    if separator == ": ":
        shipped = shipped_models() if option == "model" else set()
        assert value in choices()[option] | shipped, "nothing has this value"
    elif '"' in value:
        assert any(f"{option}:" in source and value in source for source in sources()), "nothing takes it"
    elif value:
        load(SCENE, [name])
    elif re.fullmatch(r"(avrare_|logic)\w*(\.\w+)+", name):
        module, _, attribute = name.replace("logic", "avrare.logic").rpartition(".")
        getattr(importlib.import_module(module), attribute)
    elif re.search(r"\w", name) and name not in names():
        assert any(re.search(rf"(def|class) {name}\b", source) for source in sources()), (
            "nothing has this name"
        )


@cache
def choices():
    """Return the values that each option of a component may have, where its schema lists them."""
    values = {}
    for component in COMPONENTS:
        schema = component.load_config().model_json_schema()
        definitions = schema.get("$defs", {})
        for model in (schema, *definitions.values()):
            for option, description in model.get("properties", {}).items():
                values.setdefault(option, set()).update(list_values(description, definitions))
    return values


def list_values(description, definitions):
    """Yield the values of an enumeration, and the tags of the members of a union."""
    yield from description.get("enum", ())
    for member in (*description.get("anyOf", ()), *description.get("oneOf", ())):
        yield from list_values(member, definitions)
    if reference := description.get("$ref"):
        fields = definitions[reference.rpartition("/")[2]].get("properties", {}).values()
        yield from (field["const"] for field in fields if "const" in field)


@cache
def names():
    paths = [path for folder in ("scenarios", "plugins", "avrare") for path in (ROOT / folder).iterdir()]
    vehicles = [vehicle["name"] for vehicle in load(SCENE).resolved["simulator"]["vehicles"]]
    cards = [card.name for card in (*COMPONENTS, *rules())]
    options = [options_of(command) for command in (*COMMANDS, *PROVIDED)]
    return {path.name for path in paths}.union(
        shipped_models(), vehicles, cards, choices(), *choices().values(), *options
    )


def options_of(command):
    return {*re.findall(r"--[\w-]+", command_parser(command).format_help())}


def shipped_models():
    return {path.stem for path in ROOT.glob("plugins/*/src/*/models/*.npz")}


@cache
def sources():
    folders = (ROOT / "avrare", ROOT / "benchmarks", *ROOT.glob("plugins/*/src"))
    return [path.read_text(encoding="utf-8") for folder in folders for path in folder.rglob("*.py")]
