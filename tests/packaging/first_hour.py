"""Tasks of a new user's first hour, from installed wheels, in the current folder; seconds of each task.

`check_wheels.py --first-hour` runs it in a fresh environment of each Python.
"""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
AVRARE = [sys.executable, "-m", "avrare"]


def run(*words, codes=(0,), **variables):
    """Run a command; it must end with one of these exit codes. Return what it printed."""
    done = subprocess.run(
        list(map(str, words)), capture_output=True, text=True, check=False, env={**os.environ, **variables}
    )
    assert done.returncode in codes, (words, done.stdout, done.stderr)
    return done.stdout + done.stderr


def loop_in_python():
    """Run the closed loop of docs/python.md: 1 file, 1 command."""
    (program,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/python.md").read_text(), flags=re.DOTALL)
    Path("cruise.py").write_text(program)
    run(sys.executable, "cruise.py")
    assert Path("failure.png").stat().st_size > 5000
    assert Path("report.html").stat().st_size > 10_000


def loop_as_plugin():
    """Make it a plugin: 1 file replaced in a new package, 4 commands."""
    run(*AVRARE, "new", "plugin", "cruise", "--kind", "simulator")
    program = Path("cruise.py").read_text()
    source = Path("avrare-cruise/src/avrare_cruise/simulator.py")
    loop = program[program.index("class Cruise") : program.index("rules =")]
    # A simulator's names for the same three functions; it takes the step and an action, which it ignores.
    loop = loop.replace("def initial(self, noise)", "def reset(self, noise)")
    loop = loop.replace("def step(self, state, noise)", "def step(self, state, action, noise)")
    build = "def build(config, scene=None):\n    return Cruise()\n"
    source.write_text(f'"""Cruise."""\n\nimport numpy as np\n\n\n{loop.strip()}\n\n\n{build}')
    run(
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "./avrare-cruise",
    )
    run(*AVRARE, "new", "scenario", "cruise", "--simulator", "cruise")
    run(
        *AVRARE,
        "run",
        "cruise.yaml",
        "--budget",
        "rollouts=500",
        "--set",
        'specifications.first.stl="always (gap > 12)"',
    )


def onnx_policy():
    """Put a policy of ONNX into a gymnasium environment: 1 line in a new scenario, 2 commands."""
    write_policy(Path("swing.onnx"))
    run(*AVRARE, "new", "scenario", "swing", "--simulator", "gymnasium", "--set", "env=Pendulum-v1")
    path = Path("swing.yaml")
    lines = path.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("# controller:"))
    lines[at] = "controller: {plugin: policy, model: swing.onnx}"
    path.write_text("\n".join(lines) + "\n")
    assert "first" in run(*AVRARE, "run", "swing.yaml", "--budget", "rollouts=200", "--out", "swung")


def write_policy(path):
    """Write a linear policy as a training framework would export it."""
    import numpy as np
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    gain = np.array([[0.0], [-8.0], [-2.0]], dtype=np.float32)
    shape = {"seen": ["batch", 3], "action": ["batch", 1]}
    values = {
        name: helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in shape.items()
    }
    node = helper.make_node("MatMul", ["seen", "gain"], ["action"])
    graph = helper.make_graph(
        [node], "policy", [values["seen"]], [values["action"]], [numpy_helper.from_array(gain, "gain")]
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)


def job_in_ci():
    """Run the job of docs/ci.md: no file but the scenario, 1 command."""
    threshold = "thresholds:\n  - {specification: first, probability: '< 0.001'}\n"
    Path("swing.yaml").write_text(
        Path("swing.yaml").read_text().replace("\n# thresholds:", f"\n{threshold}#")
    )
    words = [
        "check",
        "swing.yaml",
        "--looks",
        "--budget",
        "rollouts=400",
        "--junit",
        "report.xml",
        "--out",
        "gate",
    ]
    told = run(
        *AVRARE, *words, codes=(1,), GITHUB_ACTIONS="true", GITHUB_STEP_SUMMARY=os.path.abspath("summary.md")
    )
    assert "::error file=swing.yaml,line=" in told
    assert "swing" in Path("summary.md").read_text()
    assert "<failure" in Path("report.xml").read_text()


def main():
    """Do everything, and print the seconds."""
    where = run(sys.executable, "-c", "import avrare; print(avrare.__file__)")
    assert str(ROOT / "avrare") not in where, where
    print(f"Python {sys.version.split()[0]}, {where.strip()}")
    for task in (loop_in_python, loop_as_plugin, onnx_policy, job_in_ci):
        began = time.monotonic()
        task()
        print(f"{task.__name__}: {time.monotonic() - began:.0f} s: {task.__doc__}", flush=True)


if __name__ == "__main__":
    main()
