"""Safe mode: what a scenario of a stranger may not name is refused, with its place, before it is opened."""

import os
import sys
from pathlib import Path

import pytest

import avrare
from avrare.base.errors import AvrareError, UsageError
from avrare.cli.main import main
from avrare.plugin.component import Component, hookimpl
from avrare.plugin.registry import Registry, default_registry
from avrare.scenario.load import load
from avrare.scenario.safe_mode import safe_mode

SCENARIOS = Path(__file__).parents[2] / "scenarios"
GYM = """\
name: toy
steps: 3
simulator:
  plugin: gymnasium
  env: {env}
  options: {options}
controller: {controller}
specifications:
  near: {specification}
"""
PARTS = {
    "env": "Pendulum-v1",
    "options": "{}",
    "controller": "{plugin: gym_constant, action: [0.0]}",
    "specification": '{stl: "always (o0 > -2)"}',
}
SECRET = "rules: {SECRET_WORD: {formula: nothing}}\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return the folder of a stranger's scenario, with files beside it that are none of its business."""
    inner = tmp_path / "stranger"
    inner.mkdir()
    (tmp_path / "secret.npz").write_bytes(b"secret")
    (tmp_path / "secret.yaml").write_text(SECRET)
    (inner / "own.npz").write_bytes(b"own")
    (inner / "link.npz").symlink_to(tmp_path / "secret.npz")
    (inner / "away").symlink_to(tmp_path)
    monkeypatch.chdir(inner)
    return inner


def refusals(path="s.yaml", overrides=()):
    with pytest.raises(AvrareError) as caught, safe_mode():
        load(path, overrides)
    return "\n".join(caught.value.lines())


def write(text=None, **parts):
    Path("s.yaml").write_text(text or GYM.format(**PARTS | parts))


def test_an_honest_scenario_loads(folder):
    write()
    with safe_mode():
        assert load("s.yaml").name == "toy"
    assert avrare.load("s.yaml", safe=True).name == "toy"


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_scenario_loads(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with safe_mode():
        load(path)


@pytest.mark.parametrize("base", ["../base.yaml", "away/base.yaml", "link.yaml"])
def test_extends_stays_in_the_folder(folder, base):
    (folder.parent / "base.yaml").write_text(GYM.format(**PARTS))
    (folder / "link.yaml").symlink_to(folder.parent / "base.yaml")
    write(f"extends: {base}\n")
    assert load("s.yaml").name == "toy"
    assert f"s.yaml:1:10: extends: safe mode: {base!r} is outside the scenario's folder" in refusals()


def test_a_base_may_go_up_within_the_folder(folder):
    (folder / "sub").mkdir()
    (folder / "sub" / "middle.yaml").write_text("extends: ../base.yaml\n")
    (folder / "base.yaml").write_text(GYM.format(**PARTS))
    write("extends: sub/middle.yaml\n")
    with safe_mode():
        assert load("s.yaml").name == "toy"
    (folder / "sub" / "middle.yaml").write_text("extends: ../../secret.yaml\n")
    assert "sub/middle.yaml:1:10: extends: safe mode" in refusals()


def test_the_scenario_itself_may_not_be_a_link_out_of_its_folder(folder):
    (folder.parent / "real.yaml").write_text(GYM.format(**PARTS))
    Path("s.yaml").symlink_to("../real.yaml")
    assert "link to a file outside its folder" in refusals()


@pytest.mark.parametrize("kind", ["absolute", "up", "link", "through a linked folder", "home", "address"])
def test_a_model_file_is_in_the_folder(folder, kind):
    names = {
        "absolute": str(folder.parent / "secret.npz"),
        "up": "../secret.npz",
        "link": "link.npz",
        "through a linked folder": "away/secret.npz",
        "home": "~/secret.npz",
        "address": "https://example.org/secret.npz",
    }
    name = names[kind]
    write(controller=f"{{plugin: policy, model: '{name}'}}")
    assert "s.yaml:7:" in refusals()
    assert f"controller.model: safe mode: {name!r}" in refusals()
    assert "outside" in refusals() or "is not a file of" in refusals()


def test_a_model_file_in_the_folder_is_allowed(folder):
    for name in ("own.npz", str(folder / "own.npz"), "../stranger/own.npz"):
        write(controller=f"{{plugin: policy, model: '{name}'}}")
        with safe_mode():
            load("s.yaml")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("{config: {other_vehicles_type: os.path.join}}", "would import 'os'"),
        ("{config: [{a: 'evil_module:Env'}]}", "would import 'evil_module'"),
        ("{config: {file: ../secret.npz}}", "is a file outside"),
        ("{config: {file: /etc/passwd}}", "'/etc/passwd' is a file outside"),
        ("{config: {folder: away/}}", "'away/' is a file outside"),
    ],
)
def test_options_that_are_handed_on_name_no_code_and_no_file(folder, options, said):
    write(options=options)
    load("s.yaml")
    text = refusals()
    assert "simulator.options.config" in text
    assert said in text
    assert "hint: outside safe mode this is allowed" in text


def test_a_module_of_an_environment_is_that_of_a_plugin(folder):
    write(env="os:Env-v0")
    assert "'os:Env-v0' would import 'os', which is not an installed plugin" in refusals()


def test_a_block_inside_a_block_is_looked_into(folder):
    inner = "{plugin: gymnasium, env: Pendulum-v1, options: {file: ../secret.npz}}"
    outer = f"plugin: transformed\n  simulator: {inner}\n  flow: ../secret.npz"
    write(GYM.format(**PARTS).replace("plugin: gymnasium\n  env: Pendulum-v1\n  options: {}", outer))
    text = refusals()
    assert "simulator.simulator.options.file: safe mode" in text
    assert "simulator.flow: safe mode" in text


def test_a_component_of_no_distribution_is_refused(folder):
    class Plugin:
        @hookimpl
        def avrare_components(self):
            own = default_registry().get("simulator", "gymnasium")
            return [Component("simulator", "mine", own.config, own.factory, "mine")]

    registry = Registry()
    registry.register(Plugin(), "mine")
    specification = 'specifications: {x: {stl: "o0 > 0"}}\n'
    write(f"name: a\nsteps: 1\nsimulator: {{plugin: mine, env: CartPole-v1}}\n{specification}")
    load("s.yaml", registry=registry)
    with safe_mode(), pytest.raises(AvrareError, match="'mine' is of no installed plugin") as caught:
        load("s.yaml", registry=registry)
    assert caught.value.exit_code == 5


@pytest.mark.parametrize("place", ["current", "scenario's"])
def test_a_folder_of_strangers_on_the_import_path_is_refused(folder, monkeypatch, place):
    write()
    added = str(folder)
    if place == "scenario's":
        monkeypatch.chdir(folder.parent)
    monkeypatch.syspath_prepend(added)
    with pytest.raises(UsageError, match="Python would import any file in") as caught, safe_mode():
        load(folder / "s.yaml")
    assert "python -P -m avrare" in caught.value.hint
    sys.path.remove(added)
    sys.path.append(added)  # after the standard library: as an editable installation
    with safe_mode():
        load(folder / "s.yaml")


def test_no_file_outside_is_opened_and_no_program_started(folder):
    """Listen to Python's own audit of every call, for each way of naming a file."""
    names = ["../secret.npz", "link.npz", "away/secret.npz", str(folder.parent / "secret.npz")]
    texts = [GYM.format(**PARTS | {"controller": f"{{plugin: policy, model: '{name}'}}"}) for name in names]
    rule = "{plugin: traffic_rules, rules_file: ../secret.yaml, rule: X}"
    texts.append(GYM.format(**PARTS | {"specification": rule}))
    texts += [f"extends: {name}\n" for name in ("../secret.yaml", "away/secret.yaml")]
    for k, text in enumerate(texts):
        Path(f"s{k}.yaml").write_text(text)
    command = ["validate", "--build", *(f"s{k}.yaml" for k in range(len(texts)))]
    assert touched(folder, command), "the audit sees nothing"
    assert touched(folder, [*command, "--safe"]) == set()


def touched(folder, command):
    """Return the files beside ``folder`` that a command opens, and the programs that it starts, by name."""
    read, write = os.pipe()
    if child := os.fork():
        os.close(write)
        with os.fdopen(read) as pipe:
            found = set(pipe.read().splitlines())
        os.waitpid(child, 0)
        return found

    outside = str(folder.parent.resolve())

    def watch(event, arguments):
        if event in ("os.exec", "os.posix_spawn", "os.system", "subprocess.Popen"):
            os.write(write, f"{event}\n".encode())
        elif event == "open" and os.path.dirname(os.path.realpath(str(arguments[0]))) == outside:
            os.write(write, f"{arguments[0]}\n".encode())

    sys.addaudithook(watch)
    main(command)
    os._exit(0)
