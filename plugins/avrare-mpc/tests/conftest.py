"""The lane-change scene, scripted cars and a closed loop whose plant is the controller's own model."""

import importlib
import sys
import warnings
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from avrare.driving import Prediction, Road, Scene, Vehicles
from avrare_mpc.config import MpcConfig, TrajectoryPlan
from avrare_mpc.controller import build
from avrare_mpc.plan import Memory
from avrare_mpc.trajectory import plan_trajectory

LENGTH, WIDTH, DT, HORIZON = 4.298, 1.674, 0.1, 20
ROAD = Road(lane_centres=(-1.75, 1.75, 5.25), lane_width=3.5, access_ramp=(0,))
SCENE = Scene(
    dt=DT,
    road=ROAD,
    ego_length=LENGTH,
    ego_width=WIDTH,
    names=("parked", "cut_in", "merging"),
    lengths=np.full(3, LENGTH),
    widths=np.full(3, WIDTH),
    moving=np.array([False, True, True]),
)
UNIT = {"turn_rate_weight": 1.0, "turn_rate_change_weight": 1.0, "heading_weight": 1.0, "braking_weight": 1.0}
CUT_IN = TrajectoryPlan.model_validate(
    {
        **UNIT,
        "y_goal": 5.25,
        "y_goal_weight": 1.0,
        "v_goal": 25.352,
        "v_goal_weight": 20.0,
        "turn_rate_max": 1.1,
        "speed_max": 45.8,
        "schedule": [{"from_step": 0, "to_step": 4, "lane": 1}, {"from_step": 5, "to_step": 79, "lane": 2}],
    }
)
MERGING = TrajectoryPlan.model_validate(
    {
        **UNIT,
        "lanes": [0, 1],
        "y_goal_weight": 0.0,
        "v_goal": 22.29,
        "acceleration_weight": 1.0,
        "turn_rate_max": 0.4,
        "y_min": -2.263,
        "schedule": [{"from_step": 0, "to_step": 10, "lane": 0}, {"from_step": 13, "to_step": 79, "lane": 1}],
    }
)


@dataclass
class Drive:
    """States (N, T, 4), actions (N, T - 1, 2), last memory, and what each step was given."""

    states: np.ndarray
    actions: np.ndarray
    memory: Memory
    inputs: list = field(default_factory=list)


class LaneChange:
    """The scene and its scripted cars; ``x``, ``y`` and ``speed`` (along the road) are (3, 80)."""

    scene = SCENE
    cut_in_plan, merging_plan = CUT_IN, MERGING

    def __init__(self):
        self.cut_in = plan_trajectory(CUT_IN, 50.0, 1.75, 5.0, 0.0, ROAD, DT)
        self.merging = plan_trajectory(MERGING, 25.0, -1.75, 10.0, 0.0, ROAD, DT)
        moving, ones = (self.cut_in, self.merging), np.ones(80)
        self.x = np.stack([40.0 * ones, *(car.x for car in moving)])
        self.y = np.stack([1.75 * ones, *(car.y for car in moving)])
        self.speed = np.stack([0.0 * ones, *(car.speed * np.cos(car.heading) for car in moving)])

    def predict(self, step, noise):
        """Predict constant velocity along the road; noise (N, 3, 3) in metres and m/s."""
        time = np.arange(HORIZON + 1) * DT
        x, y, speed = (part[:, step] + noise[..., k] for k, part in enumerate((self.x, self.y, self.speed)))
        return Prediction(x=x[..., None] + speed[..., None] * time, y=np.repeat(y[..., None], HORIZON + 1, 2))

    def follower(self, backend, **options):
        """Return a controller that follows its plan."""
        config = {"backend": backend, "search": "follow", "stops": False, **options}
        return build(MpcConfig.model_validate(config), SCENE)

    def noise(self, n, samples, seed):
        """Return observation noise of a drive (N, samples - 1, 3, 3)."""
        normals = np.random.default_rng(seed).standard_normal((n, samples - 1, 3, 3))
        return np.array([0.3, 0.15, 0.3]) * normals

    def first_situations(self, n, x, horizon=HORIZON):
        """Return states of the ego near ``x`` and noisy predictions, as at the first step."""
        rng = np.random.default_rng(3)
        state = np.array([x, 1.75, 21.6, 0.0]) + [1.0, 0.3, 1.0, 0.02] * rng.standard_normal((n, 4))
        seen = self.predict(0, 0.2 * rng.standard_normal((n, 3, 3)))
        return ego_at(state), Prediction(seen.x[..., : horizon + 1], seen.y[..., : horizon + 1])

    def blind(self, prediction):
        """Return a prediction without a value along the road."""
        return Prediction(x=np.full_like(prediction.x, np.nan), y=prediction.y)

    def drive(self, controller, noise) -> Drive:
        """Drive the closed loop on the controller's own model, observation noise (N, samples - 1, 3, 3)."""
        n = len(noise)
        memory = controller.start(n)
        states, actions, inputs = [np.tile([17.149, 1.75, 21.6, 0.0], (n, 1))], [], []
        for step in range(noise.shape[1]):
            given = (memory, ego_at(states[-1]), self.predict(step, noise[:, step]))
            inputs.append(given)
            action, memory = controller.act(*given)
            actions.append(np.stack([action.acceleration, action.yaw_rate], axis=1))
            states.append(roll(states[-1], action))
        return Drive(np.stack(states, 1), np.stack(actions, 1), memory, inputs)

    def gaps(self, states):
        """Return smallest distance of the axis-parallel rectangles over time, (N, 3)."""
        steps = states.shape[1]
        along = np.abs(states[:, None, :, 0] - self.x[:, :steps]) - LENGTH
        across = np.abs(states[:, None, :, 1] - self.y[:, :steps]) - WIDTH
        return np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0)).min(axis=2)


@pytest.fixture(scope="session")
def lane_change():
    return LaneChange()


@pytest.fixture(scope="session")
def quiet(lane_change):
    """Return a controller and its drive without noise."""
    controller = lane_change.follower("casadi")
    return controller, lane_change.drive(controller, np.zeros((1, 39, 3, 3)))


@pytest.fixture(scope="session")
def plain():
    """Return the modules of the riccati backend as they are where numba is not installed."""
    prefix = "avrare_mpc.riccati"
    compiled = {name: sys.modules.pop(name) for name in list(sys.modules) if name.startswith(prefix)}
    numba, sys.modules["numba"] = sys.modules.get("numba"), None
    names = ("jit", "lanes", "functions", "values", "cost", "sweep", "newton", "batch", "solver")
    try:
        modules = {name: importlib.import_module(f"{prefix}.{name}") for name in names}
    finally:
        for name in [name for name in sys.modules if name.startswith(prefix)]:
            del sys.modules[name]
        sys.modules.update(compiled)
        del sys.modules["numba"]
        if numba is not None:
            sys.modules["numba"] = numba
    return SimpleNamespace(**modules)


@pytest.fixture(scope="session")
def interpreted(plain):
    """Return a function (config, scene) -> solver that is not compiled."""

    def build_solver(config, scene):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            return plain.solver.RiccatiSolver(config, scene)

    return build_solver


def ego_at(state):
    """Return state (N, 4) x, y, speed, heading."""
    x, y, speed, heading = state.T
    return Vehicles(x=x, y=y, heading=heading, speed=speed, acceleration=np.zeros(len(state)))


def roll(state, action):
    _, _, speed, heading = state.T
    change = speed * np.cos(heading), speed * np.sin(heading), action.acceleration, action.yaw_rate
    return state + DT * np.stack(change, axis=1)
