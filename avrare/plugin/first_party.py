"""Components of the core, and the names of those in this project's other distributions."""

from __future__ import annotations

from avrare.plugin.component import CheckRole, Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the components that need no further package."""
    return [
        Component(
            kind="simulator",
            name="python",
            config="avrare.stack.python_file:SimulatorConfig",
            factory="avrare.stack.python_file:build_simulator",
            summary="a class in a Python file",
        ),
        Component(
            kind="controller",
            name="python",
            config="avrare.stack.python_file:ControllerConfig",
            factory="avrare.stack.python_file:build_controller",
            summary="a class in a Python file",
        ),
        Component(
            kind="controller",
            name="function",
            config="avrare.stack.python_file:FunctionConfig",
            factory="avrare.stack.python_file:build_function",
            summary="a plain function act(observation) in a Python file, for a first try",
        ),
        Component(
            kind="estimator",
            name="mc",
            config="avrare.estimation.monte_carlo.config:McConfig",
            factory="avrare.estimation.monte_carlo.monte_carlo:build",
            summary="plain Monte Carlo, with Clopper-Pearson intervals",
            cross_check=CheckRole(order=90),
            charts="avrare.estimation.monte_carlo.charts:draw_charts",
            shares_rollouts=True,
        ),
        Component(
            kind="estimator",
            name="auto",
            config="avrare.estimation.choice.auto_config:AutoConfig",
            factory="avrare.estimation.choice.auto:build",
            summary="chooses for each specification by a Monte Carlo pilot",
        ),
        Component(
            kind="executor",
            name="serial",
            config="avrare.rollout.executors.work:ExecutorConfig",
            factory="avrare.rollout.executors.serial:build",
            summary="one chunk after another in this process",
        ),
        Component(
            kind="executor",
            name="processes",
            config="avrare.rollout.executors.work:ExecutorConfig",
            factory="avrare.rollout.executors.processes:build",
            summary="chunks on worker processes of this machine",
        ),
    ]


_PROVIDED: dict[str, dict[str, tuple[str, ...]]] = {
    "avrare-estimators": {"estimator": ("ams", "is", "ce", "ess", "mfmc", "smc")},
    "avrare-example": {"simulator": ("tank",), "specification": ("spillage",)},
    "avrare-flows": {"simulator": ("transformed",)},
    "avrare-fmi": {"simulator": ("fmi",), "controller": ("fmi",)},
    "avrare-glider": {"simulator": ("glider",)},
    "avrare-gp-pem": {"perception": ("gp_pem", "parametric", "naive")},
    "avrare-gymnasium": {"simulator": ("gymnasium",), "controller": ("gym_feedback", "gym_constant")},
    "avrare-highway-env": {"simulator": ("highway_env",), "controller": ("path_follower",)},
    "avrare-imm": {"tracker": ("imm", "filterpy")},
    "avrare-linear": {"simulator": ("linear",), "estimator": ("ess_linear",)},
    "avrare-metadrive": {"simulator": ("metadrive",), "controller": ("metadrive_expert",)},
    "avrare-mpc": {"controller": ("mpc",)},
    "avrare-openscenario": {"simulator": ("openscenario",)},
    "avrare-policy": {"controller": ("policy",)},
    "avrare-process": {"simulator": ("process",), "controller": ("process",)},
    "avrare-ray": {"executor": ("ray",)},
    "avrare-reference-drivers": {
        "controller": ("reference_driver", "cruise", "hold"),
        "specification": ("avoidable_collision",),
    },
    "avrare-single-track": {"simulator": ("single_track", "commonroad")},
    "avrare-traffic-rules": {"specification": ("traffic_rules",)},
}
FIRST_PARTY = {
    (kind, name): distribution
    for distribution, kinds in _PROVIDED.items()
    for kind, names in kinds.items()
    for name in names
}
"""(kind, name) of a component -> the distribution of this project that provides it."""

TWIN_ESTIMATOR = "mfmc"
"""Estimator of scenarios with a cheap twin that name none."""

PACKAGES = {
    "PIL": "pillow",
    "commonroad": "commonroad-io",
    "cv2": "opencv-python",
    "metadrive": "metadrive-simulator==0.4.3",  # `metadrive` on PyPI is another project
    "pyro": "pyro-ppl",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}
"""Top-level module -> the package that provides it, where the names differ."""


def pip_line(*modules: str) -> str:
    """Return the pip command that installs the packages of these modules."""
    packages = sorted({PACKAGES.get(top, top) for top in (module.split(".")[0] for module in modules)})
    return "pip install " + " ".join(packages)
