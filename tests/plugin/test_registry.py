import sys
from importlib.metadata import EntryPoint

import pytest

from avrare.base.errors import PluginError, UsageError
from avrare.plugin import Component, hookimpl
from avrare.plugin.first_party import FIRST_PARTY
from avrare.plugin.registry import Registry

HOOK = "from avrare.plugin import hookimpl\n@hookimpl\ndef avrare_components"


def part(name="one", kind="tracker", **changes):
    values = {"config": "json:JSONDecoder", "factory": "json:loads", "summary": "for tests"} | changes
    return Component(kind=kind, name=name, **values)


class Plugin:
    def __init__(self, *parts):
        self.parts = parts

    @hookimpl
    def avrare_components(self):
        return list(self.parts)


def with_plugins(**plugins):
    registry = Registry()
    for name, plugin in plugins.items():
        registry.register(plugin, name, f"dist-{name}", "1.0")
    return registry


def the_row(registry, name):
    [row] = [row for row in registry.rows() if row.name == name]
    return row


def test_the_cores_own_components_come_through_the_same_hook():
    registry = Registry()
    assert registry.get("estimator", "mc").factory == "avrare.estimation.monte_carlo.monte_carlo:build"
    assert registry.names("executor") == ["processes", "serial"]
    assert {row.distribution for row in registry.rows()} == {"avrare"}


def test_a_plugin_is_discovered_by_its_entry_point(fake):
    registry = Registry.discover()
    row = registry.find("tracker", "straight")
    assert (row.distribution, row.version, row.status) == ("avrare-fake", "1.2", "ok")
    assert "avrare_fake_heavy" not in sys.modules


def test_a_plugin_that_is_left_out_is_not_imported(fake, monkeypatch):
    monkeypatch.delitem(sys.modules, "avrare_fake", raising=False)
    monkeypatch.setenv("AVRARE_PLUGINS", "")
    row = the_row(Registry.discover(), "fake")
    assert (row.status, row.distribution) == ("blocked", "avrare-fake")
    assert "avrare_fake" not in sys.modules
    monkeypatch.setenv("AVRARE_PLUGINS", " fake , ghost ")
    registry = Registry.discover()
    assert registry.get("tracker", "straight").name == "straight"
    assert the_row(registry, "ghost").status == "broken"


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("1/0", "ZeroDivisionError"),
        ("x = (", "SyntaxError"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("pass", "TypeError: it has no hook avrare_components"),
        (f"{HOOK}(): return 1/0", "ZeroDivisionError"),
        (f"{HOOK}(): return [3]", "3, which is not a"),
        (f"{HOOK}(x): return []", "PluginValidation"),
    ],
)
def test_a_broken_plugin_is_a_row_and_does_not_disturb_others(tmp_path, monkeypatch, source, reason):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "avrare_broken.py").write_text(source)
    monkeypatch.delitem(sys.modules, "avrare_broken", raising=False)
    registry = Registry([EntryPoint("shaky", "avrare_broken", "avrare")])
    monkeypatch.delitem(sys.modules, "avrare_broken", raising=False)
    row = the_row(registry, "shaky")
    assert row.status == "broken"
    assert reason in row.detail
    assert "\n" not in row.detail
    assert registry.get("estimator", "mc").name == "mc"


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (part(kind="wheel"), "unknown kind 'wheel'"),
        (part(config="json"), "config is 'json'"),
        (part(factory=None), "factory is None"),
        (part(name=3), "name is 3"),
        (part(cross_check=True), "cross_check is True, not of type CheckRole"),
        (part(charts="draw"), "charts is 'draw'"),
        (part(auto=10), "auto is 10, not of type AutoRole"),
        (part(warnings={"worn": 3}), "warnings should be texts by name, not {'worn': 3}"),
    ],
)
def test_descriptions_are_verified(bad, words):
    registry = with_plugins(odd=Plugin(part("fine"), bad))
    assert words in the_row(registry, "odd").detail
    assert registry.names("tracker") == []


def test_components_declare_warnings_that_can_be_suppressed():
    registry = with_plugins(a=Plugin(part(warnings={"worn_tyres": "{grip} of the grip is left"})))
    assert {"errors", "outliers", "worn_tyres"} <= set(registry.warnings())
    registry.check_suppressed(["worn_tyres", "outliers"])
    with pytest.raises(UsageError, match="unknown health warning 'worn_tires'") as caught:
        registry.check_suppressed(["outliers", "worn_tires"])
    assert caught.value.hint == "did you mean 'worn_tyres'?"
    with pytest.raises(UsageError, match="cannot be suppressed"):
        registry.check_suppressed(["errors"])


def test_another_interface_version_is_incompatible():
    registry = with_plugins(next=Plugin(part(api=2)))
    assert the_row(registry, "one").status == "incompatible"
    with pytest.raises(PluginError, match="written for plugin interface 2; this avrare has 1"):
        registry.get("tracker", "one")


def test_duplicates_name_both_distributions():
    registry = with_plugins(a=Plugin(part()), b=Plugin(part()), c=Plugin(part(kind="controller")))
    with pytest.raises(PluginError, match=r"'one' is provided by both dist-a 1\.0 and dist-b 1\.0"):
        registry.get("tracker", "one")
    assert [row.status for row in registry.rows() if row.kind == "tracker"] == ["broken", "broken"]
    assert registry.get("controller", "one").kind == "controller"


def test_missing_dependencies_are_found_without_importing(monkeypatch):
    monkeypatch.delitem(sys.modules, "this", raising=False)
    one, two = part("one", needs=("pyro.infer", "this", "no_such")), part("two", needs=("this",))
    registry, absent = with_plugins(a=Plugin(one, two)), ("pyro", "no_such")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in absent else object())
    row = the_row(registry, "one")
    assert row.status == "missing dependency"
    assert row.detail == "needs pyro, no_such: pip install no_such pyro-ppl"
    assert registry.get("tracker", "one").name == "one"
    with pytest.raises(PluginError) as caught:
        registry.require("tracker", "one")
    assert caught.value.hint == "pip install no_such pyro-ppl"
    assert registry.require("tracker", "two").name == "two"
    assert "this" not in sys.modules


def test_unknown_names_get_a_hint():
    registry = with_plugins(a=Plugin(part("straight")))
    for kind, name, message, hint in [
        ("tracker", "strait", "unknown tracker 'strait'", "did you mean 'straight'?"),
        ("controller", "straight", "unknown controller 'straight'", "'straight' is a tracker; installed con"),
        ("estimator", "quux", "unknown estimator 'quux'", "known: ams, auto, ce, ess, ess_linear, is, mc"),
    ]:
        with pytest.raises(PluginError) as caught:
            registry.get(kind, name)
        assert caught.value.message == message
        assert caught.value.hint.startswith(hint)
        assert int(caught.value.exit_code) == 5


@pytest.mark.parametrize(("kind", "name"), FIRST_PARTY)
def test_our_own_plugins_are_known_where_they_are_not_installed(kind, name):
    with pytest.raises(PluginError) as caught:
        Registry().get(kind, name)
    home = FIRST_PARTY[kind, name]
    assert caught.value.lines() == [
        f"unknown {kind} {name!r}: provided by {home}, which is not installed",
        f"hint: pip install {home}",
    ]
