"""MetaDrive engine: the only module that imports MetaDrive; runs in separate processes, one engine each."""

from __future__ import annotations

import sys
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from avrare.protocols import Floats
from avrare_metadrive import version
from avrare_metadrive.config import RANGE, SIGNALS, MetaDriveConfig
from avrare_metadrive.expert import OTHERS
from avrare_metadrive.process import serve


class Engine:
    """MetaDrive with one car.

    ``begin`` starts it once per process; further engines are copies of the process.
    """

    def __init__(self) -> None:
        self.environment: Any = None
        self.lasers = 0
        self._observation = np.empty(0)
        self._outcome: dict[str, Any] = {}

    def begin(self, config: MetaDriveConfig) -> Floats:
        """Start MetaDrive and return the numbers (K,) of ``step`` at t = 0.

        Raises:
            PluginError: The installed version is not supported.
        """
        version.check_supported()
        # Physics needs no assets; without this the engine downloads them at its start.
        import_module("metadrive.engine.base_engine").BaseEngine.try_pull_asset = staticmethod(lambda: None)
        self.lasers = config.lasers
        self.environment = import_module("metadrive.envs.metadrive_env").MetaDriveEnv(_options(config))
        return self.reset()

    def reset(self) -> Floats:
        """Reset to t = 0 and return the numbers (K,)."""
        self._observation, _ = self.environment.reset(seed=self.environment.config["start_seed"])
        self._outcome = {}
        return self._numbers()

    def step(self, steering: float, throttle: float) -> Floats:
        """Advance by 0.1 s; return the signals in the order of ``SIGNALS``, then the observation, (K,).

        Args:
            steering: Steering in [-1, 1], left is positive.
            throttle: Throttle in [-1, 1], negative brakes.
        """
        self._observation, _, _, _, self._outcome = self.environment.step([steering, throttle])
        return self._numbers()

    def picture(self, width: int, height: int, scaling: float) -> Any:
        """Return a top view around the car, (height, width, 3) bytes; ``scaling`` in pixels per metre."""
        return self.environment.render(
            mode="topdown",
            window=False,
            screen_size=(width, height),
            scaling=scaling,
            film_size=(int(500 * scaling), int(500 * scaling)),
        )

    def _numbers(self) -> Floats:
        car, outcome = self.environment.agent, self._outcome
        route = car.navigation
        arrived, crashed, off = (bool(outcome.get(key)) for key in ("arrive_dest", "crash", "out_of_road"))
        signals = {
            "x": car.position[0],
            "y": car.position[1],
            "heading": car.heading_theta,
            "speed": car.speed,
            "completion": route.route_completion,
            "remaining": route.total_length - route.travelled_length,
            "nearest": RANGE * self._observation[-self.lasers :].min(),
            "reward": outcome.get("episode_reward", 0.0),
            "arrived": arrived,
            "crashed": crashed,
            "off_road": off,
            "over": arrived or crashed or off,
        }
        return np.concatenate([[signals[name] for name in SIGNALS], self._observation], dtype=np.float64)


def _options(config: MetaDriveConfig) -> dict[str, object]:
    return {
        "map": config.map,
        "traffic_density": config.traffic_density,
        "traffic_mode": config.traffic_mode,
        "start_seed": config.start_seed,
        "num_scenarios": 1,
        "use_render": False,
        "log_level": 50,
        "force_destroy": True,  # else state remains after a reset
        "vehicle_config": {
            "lidar": {"num_lasers": config.lasers, "distance": RANGE, "num_others": OTHERS},
        },
    }


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])), Engine())
