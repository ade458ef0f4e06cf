"""FMUs as simulators and controllers: the same rollouts as in Python."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import avrare
from avrare.base.errors import UsageError
from avrare.scenario.safe_mode import safe_mode
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.python_file import TEMPLATES, find_member
from avrare.testing.conformance import Subject, checks_of
from avrare_fmi.config import FmuConfig, SimulatorConfig

pytest.importorskip("pythonfmu")
parts = pytest.importorskip("avrare_fmi.parts", reason="FMPy is not installed")
FOLDER = Path(__file__).parent
RULE = avrare.stl("always (gap > 5)")
ROAD = {
    "inputs": ("acceleration",),
    "outputs": ("gap", "speed"),
    "seen": ("measured", "speed", "lead"),
    "noise": {"radar": 1.0},
}
CRUISE = {"inputs": ("gap", "speed", "lead"), "outputs": ("acceleration",)}
TIME = 'self.register_variable(Float64("time", causality=Fmi3Causality.independent))'
TO_FMI_3 = {
    "pythonfmu": "pythonfmu3", "Fmi2": "Fmi3", "Real": "Float64", "Integer": "Int32",
    "names = (": f"{TIME}\n        names = (", '("time", "error")': '("error",)',
}  # fmt: skip
STATES = {"canGetAndSetFMUstate": True, "canSerializeFMUstate": True}


@pytest.fixture(scope="session")
def build(tmp_path_factory):
    def build_fmu(name, **flags):
        from pythonfmu.builder import FmuBuilder

        folder = tmp_path_factory.mktemp("fmu")
        return str(FmuBuilder.build_FMU(FOLDER / f"{name}.py", folder, **flags))

    return build_fmu


@pytest.fixture(scope="session")
def road(build):
    return build("road", **STATES)


@pytest.fixture(scope="session")
def cruise(build):
    return build("cruise", **STATES)


@pytest.fixture(scope="session")
def reference():
    files = {"Simulator": "stack.py.txt", "Controller": "stack_controller.py.txt"}
    simulator, controller = (find_member(str(TEMPLATES / file), name, "")() for name, file in files.items())
    return {name: estimate(ClosedLoop(simulator, controller=controller), name) for name in ("mc", "ams")}


def loop(road, cruise, **options):
    simulator = parts.build_simulator(SimulatorConfig(file=road, **{**ROAD, **options}))
    return ClosedLoop(simulator, controller=parts.build_controller(FmuConfig(file=cruise, **CRUISE)))


def estimate(system, estimator, workers=1):
    options = {"particles": 20, "discard": 2, "runs": 2} if estimator == "ams" else {"rollouts": 60}
    problem = avrare.Problem(system, RULE, steps=100, chunk=30)
    return avrare.estimate(problem, estimator, seed=1, workers=workers, **options)


def assert_same(result, wanted):
    assert 0 < result.probability < 1
    assert result.probability == wanted.probability
    np.testing.assert_array_equal(result.robustness, wanted.robustness)


@pytest.mark.parametrize("estimator", ["mc", "ams"])
@pytest.mark.parametrize("workers", [1, 2])
def test_fmus_give_the_bits_of_a_python_file(reference, road, cruise, estimator, workers):
    assert_same(estimate(loop(road, cruise), estimator, workers), reference[estimator])


@pytest.mark.parametrize("flags", [{}, {"canGetAndSetFMUstate": True}])
def test_branches_by_replay_and_by_states_without_bytes_agree(reference, build, flags):
    system = loop(build("road", **flags), build("cruise", **flags))
    assert_same(estimate(system, "ams"), reference["ams"])


def test_start_values_of_any_type_change_the_rollout(road):
    def gap(**start):
        options = {**ROAD, "outputs": ("gap", "steps")}
        simulator = parts.build_simulator(SimulatorConfig(file=road, start=start, **options))
        world = simulator.reset(np.zeros((2, 1)))
        for _ in range(50):
            world = simulator.step(world, np.zeros((2, 1)), np.zeros((2, 1)))
        assert simulator.signals(world)["steps"].tolist() == [50, 50]
        return simulator.signals(world)["gap"][0]

    assert gap() < gap(braking=3.0) < gap(hard=False) == 40.0


@pytest.mark.parametrize(
    ("options", "message"),
    [({"outputs": ("gaps",)}, "no variable 'gaps'"), ({"start": {"brakes": 1.0}}, "no variable 'brakes'")],
)
def test_unknown_variables_are_told(road, options, message):
    with pytest.raises(UsageError, match=message):
        parts.build_simulator(SimulatorConfig(file=road, **{**ROAD, **options}))


def test_an_action_that_does_not_fit_is_told(road):
    simulator = parts.build_simulator(SimulatorConfig(file=road, **ROAD))
    world = simulator.reset(np.zeros((2, 1)))
    for action in (None, np.zeros((2, 2))):
        with pytest.raises(UsageError, match="inputs acceleration get values"):
            simulator.step(world, action, np.zeros((2, 1)))


def test_states_need_their_flag(build):
    with pytest.raises(UsageError, match="canGetAndSetFMUstate is not set"):
        parts.build_simulator(SimulatorConfig(file=build("road"), copy="state", **ROAD))


def test_a_single_instance_runs_one_rollout_at_a_time(build):
    file = build("road", canBeInstantiatedOnlyOncePerProcess=True)
    simulator = parts.build_simulator(SimulatorConfig(file=file, **ROAD))
    world = simulator.reset(np.zeros((1, 1)))
    simulator.step(world, np.zeros((1, 1)), np.zeros((1, 1)))
    with pytest.raises(UsageError, match="only once per process"):
        simulator.reset(np.zeros((2, 1)))


def test_a_file_that_is_no_fmu_is_told(tmp_path):
    (tmp_path / "road.fmu").write_text("no archive")
    for name, message in (("road.fmu", "no FMU that can be read"), ("none.fmu", "no such file")):
        with pytest.raises(UsageError, match=message):
            parts.build_simulator(SimulatorConfig(file=str(tmp_path / name), **ROAD))


def test_safe_mode_runs_no_fmu():
    with safe_mode(), pytest.raises(ValidationError, match="safe mode"):
        FmuConfig(file="road.fmu", outputs=("gap",))


def test_fmi_3(reference, cruise, tmp_path):
    builder = pytest.importorskip("pythonfmu3.builder")
    text = (FOLDER / "road.py").read_text()
    for old, new in TO_FMI_3.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "road3.py").write_text(text)
    file = str(builder.FmuBuilder.build_FMU(tmp_path / "road3.py", tmp_path))
    for estimator in ("mc", "ams"):
        assert_same(estimate(loop(file, cruise), estimator), reference[estimator])


def test_conformance(road, cruise):
    subjects = (
        Subject.find_installed("simulator", "fmi", file=road, **{**ROAD, "inputs": ()}),
        Subject.find_installed("controller", "fmi", file=cruise, **CRUISE),
    )
    for subject in subjects:
        for check in checks_of(subject.kind):
            outcome = check.run(subject)
            assert outcome.status != "failed", f"{check.name}: {outcome.reason}"
