"""Names that we know of even where nothing is installed, so that a message can give the pip line."""

from __future__ import annotations

FIRST_PARTY: dict[tuple[str, str], str] = {
    ("simulator", "single_track"): "avrare-single-track",
    ("perception", "gp_pem"): "avrare-gp-pem",
    ("perception", "parametric"): "avrare-gp-pem",
    ("perception", "naive"): "avrare-gp-pem",
    ("tracker", "imm"): "avrare-imm",
    ("controller", "mpc"): "avrare-mpc",
    ("specification", "traffic_rules"): "avrare-traffic-rules",
    ("estimator", "ams"): "avrare-estimators",
    ("estimator", "is"): "avrare-estimators",
    ("estimator", "ce"): "avrare-estimators",
    ("estimator", "ess"): "avrare-estimators",
    ("simulator", "linear"): "avrare-linear",
    ("simulator", "transformed"): "avrare-flows",
    ("estimator", "ess_linear"): "avrare-linear",
    ("simulator", "highway_env"): "avrare-highway-env",
    ("controller", "path_follower"): "avrare-highway-env",
    ("controller", "policy"): "avrare-policy",
    ("executor", "ray"): "avrare-ray",
    ("simulator", "gymnasium"): "avrare-gymnasium",
    ("simulator", "glider"): "avrare-glider",
    ("controller", "gym_feedback"): "avrare-gymnasium",
    ("controller", "gym_constant"): "avrare-gymnasium",
    ("simulator", "metadrive"): "avrare-metadrive",
    ("controller", "metadrive_expert"): "avrare-metadrive",
    ("simulator", "tank"): "avrare-example",
    ("specification", "spillage"): "avrare-example",
}
"""(kind, name) of a component -> the distribution of this project that provides it."""

PACKAGES = {
    "PIL": "pillow",
    "cv2": "opencv-python",
    "metadrive": "metadrive-simulator==0.4.3",  # `metadrive` is somebody else's
    "pyro": "pyro-ppl",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}
"""Top-level module -> the package that provides it, where the names differ."""


def pip_line(*modules: str) -> str:
    """The command that installs the packages of these modules."""
    packages = sorted({PACKAGES.get(top, top) for top in (module.split(".")[0] for module in modules)})
    return "pip install " + " ".join(packages)
