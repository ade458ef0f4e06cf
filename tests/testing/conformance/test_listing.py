"""``avrare plugins --timing``: what importing each description costs."""

import json
import sys
from types import SimpleNamespace

from avrare.cli import plugins
from avrare.cli.main import main


def rows(capsys, *words):
    assert main(["plugins", "--json", *words]) == 0
    return json.loads(capsys.readouterr().out)


def test_times_are_shown_on_demand(capsys):
    timed = rows(capsys, "--timing")
    assert {row["import_seconds"] is not None for row in timed if row["distribution"] == "avrare-imm"} == {
        True
    }
    assert {row["import_seconds"] for row in timed if row["distribution"] == "avrare"} == {None}
    plain = [{key: row[key] for key in row if key != "import_seconds"} for row in timed]
    assert plain == rows(capsys)


def test_a_slow_import_is_the_one_that_is_shown(monkeypatch):
    clock = iter([0.0, 0.25, 1.0, 1.5])
    monkeypatch.setattr(plugins.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(plugins, "entry_points", lambda group: [Point("slow"), Point("slower")])
    monkeypatch.delenv("AVRARE_PLUGINS", raising=False)
    assert plugins._import_seconds() == {"avrare-slow": 0.25, "avrare-slower": 0.5}


class Point:
    """An entry point; one of them cannot be loaded."""

    def __init__(self, name):
        self.name = name
        self.dist = SimpleNamespace(name=f"avrare-{name}")

    def load(self):
        if self.name == "broken":
            sys.exit("broken")
