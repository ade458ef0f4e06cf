"""Worker processes: what can go wrong there is said in one sentence, and nothing hangs."""

import pickle
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.rollout.executors.processes import ProcessExecutor
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Work
from avrare.rollout.executors.worker_pool import WorkerDied
from avrare.rollout.noise import NoiseSource
from avrare.testing import faulty_systems as systems
from rollout_requests import cut

CHUNK = 25


def problem(system=None, score=None, steps=10, limit=0.3, **options):
    formula = avrare.stl(f"always (x < {limit})")
    return avrare.Problem(system or systems.Walk(), formula, steps, score, chunk=CHUNK, **options)


def estimate(task, **options):
    return avrare.estimate(task, **{"workers": 2, "rollouts": 100, **options})


def run_script(tmp_path, code, how="file"):
    """Run Python code as a program of its own, from a file, as -c, or from standard input."""
    path = tmp_path / "program.py"
    path.write_text(code)
    arguments = {"file": [str(path)], "command": ["-c", code], "stdin": ["-"]}[how]
    return subprocess.run(
        [sys.executable, *arguments], input=code if how == "stdin" else None, capture_output=True, text=True,
        timeout=60, check=False, env={"PATH": "", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip


PROGRAM = """
import numpy as np
import avrare
class Walk:
    noise_size = 1
    def initial(self, noise): return {"x": np.zeros(len(noise))}
    def step(self, state, noise): return {"x": state["x"] + 0.1 * noise[:, 0]}
    def signals(self, state): return {"x": state["x"]}
def main():
    problem = avrare.Problem(Walk(), avrare.stl("always (x < 0.3)"), steps=10, chunk=25)
    for estimator in ("mc", "ams"):
        options = {"rollouts": 100} if estimator == "mc" else {"particles": 20, "discard": 5, "runs": 2}
        try:
            one, two = (avrare.estimate(problem, estimator, workers=w, **options) for w in (1, 2))
            print(one.probability == two.probability)
        except avrare.AvrareError as error:
            print(type(error).__name__, error, error.hint)
"""
GUARD = 'if __name__ == "__main__": '


@pytest.mark.slow
@pytest.mark.parametrize("executor", [SerialExecutor, lambda: ProcessExecutor(2)])
def test_outcomes_come_in_the_order_of_the_chunks(executor):
    task, noise = problem(), NoiseSource(0, 1)
    chunks = cut(90, CHUNK)
    work = Work(task, noise, scored=False)
    expected = [work.run(chunk).robustness for chunk in chunks]
    one = executor()
    one.open(work)
    with closing(one):
        found = [outcome.robustness for outcome in one.map(chunks)]
    assert len(found) == 4
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.slow
def test_a_row_that_raises_in_a_worker_is_an_error():
    task = problem(systems.Fragile("raise", 2.0))
    one, two = (avrare.estimate(task, workers=workers, rollouts=100) for workers in (1, 2))
    assert 0 < two.errors < 100
    assert (two.errors, two.health) == (one.errors, one.health)
    np.testing.assert_array_equal(one.robustness, two.robustness)


@pytest.mark.slow
def test_a_worker_that_dies_is_reported():
    with pytest.raises(WorkerDied, match="without an answer") as caught:
        estimate(problem(odd_systems.Deadly()))
    assert "a single worker" in caught.value.hint
    assert avrare.estimate(problem(odd_systems.Deadly()), rollouts=10).errors == 0


@pytest.mark.slow
@pytest.mark.parametrize("accident", ["die_in_its_answer", "stop", "run_out_of_memory", "leave_a_child"])
def test_an_accident_of_a_worker_costs_its_chunk_only(tmp_path, accident):
    """Run the lost chunk again: the outcome is that of an undisturbed run."""
    system = odd_systems.OnceInAWorker(accident, str(tmp_path / "marker"))
    executor, noise = ProcessExecutor(2), NoiseSource(0, 1)
    work = Work(problem(system), noise, scored=True)
    chunks = cut(240, 40)
    executor.open(work)
    with closing(executor):
        found = [outcome.scores for outcome in executor.map(chunks)]
    assert executor.restarts == 1
    np.testing.assert_array_equal(found, [work.run(chunk).scores for chunk in chunks])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "workers", "message"),
    [
        ("abort", 1, "the rollout ended its process (SIGABRT)"),
        ("fault", 2, "the rollout ended its process (SIGSEGV)"),
        ("exit", 2, "the rollout ended its process (exit code 5)"),
        ("hang", 1, "the rollout takes more than 2 s"),
    ],
)
def test_a_rollout_that_ends_its_process_or_hangs_is_an_error(end, workers, message):
    """Compare with a system that raises there."""
    raises = avrare.estimate(problem(systems.Fragile("raise", 2.9)), rollouts=200)
    native = problem(odd_systems.Native(end, 2.9), rollout_timeout=2.0)
    with pytest.warns(avrare.HealthWarning, match="errors"):
        native = estimate(native, rollouts=200, workers=workers)
    assert native.errors == raises.errors == 3
    assert message in native.health["errors"]
    np.testing.assert_array_equal(native.robustness, raises.robustness)
    assert (native.probability, native.interval) == (raises.probability, raises.interval)


@pytest.mark.slow
def test_branches_that_end_their_process_are_errors_of_splitting():
    """Their scores are those where they branched, for any number of workers."""
    native = problem(odd_systems.Native("abort", 3.1), limit=0.8, rollout_timeout=60.0)
    options = {"particles": 60, "discard": 10, "runs": 2, "suppress": ["few_roots"]}
    one, two = (avrare.estimate(native, "ams", workers=workers, **options) for workers in (1, 2))
    assert one.errors > 0
    assert (one.errors, one.probability) == (two.errors, two.probability)
    assert one.probability == pytest.approx(0.0077, rel=0.5)
    np.testing.assert_array_equal(one.failures.noise, two.failures.noise)


@pytest.mark.slow
def test_a_leak_up_to_the_limit_of_memory_costs_workers_alone():
    leaking = problem(odd_systems.Leak(), rollout_timeout=60.0)
    executor = SerialExecutor()
    executor.open(Work(leaking, NoiseSource(0, 1), scored=False))
    with closing(executor):
        found = np.concatenate([outcome.robustness for outcome in executor.map(cut(300, CHUNK))])
    assert executor.restarts > 0
    np.testing.assert_array_equal(found[:, 0], avrare.estimate(problem(), rollouts=300).robustness)


def test_a_system_that_cannot_be_unpickled_in_a_worker():
    with pytest.raises(avrare.UsageError, match="lives in one process only"):
        estimate(problem(odd_systems.Homesick()))


def local_system():
    class Local(systems.Walk):
        pass

    return Local()


@pytest.mark.parametrize(
    "task", [lambda: problem(local_system()), lambda: problem(score=lambda signals, t: signals["x"][:, t])]
)
def test_an_unpicklable_system_is_a_usage_error(task):
    with pytest.raises(avrare.UsageError, match="cannot be sent") as caught:
        estimate(task())
    assert "workers=1" in caught.value.hint


@pytest.mark.slow
def test_a_guarded_script_may_use_workers(tmp_path):
    done = run_script(tmp_path, PROGRAM + GUARD + "main()")
    assert done.stdout.split() == ["True", "True"], done.stderr


@pytest.mark.parametrize("how", ["command", "stdin"])
def test_an_interactive_session_gets_the_reason_for_no_workers(tmp_path, how):
    done = run_script(tmp_path, PROGRAM + GUARD + "main()", how)
    assert done.returncode == 0
    assert done.stdout.count("UsageError the problem is defined in a session") == 2
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_an_unguarded_script_gets_a_hint_about_the_guard(tmp_path):
    done = run_script(tmp_path, PROGRAM + "main()")
    assert done.returncode == 0
    assert done.stdout.count("UsageError worker processes import this script") == 2
    assert "__main__" in done.stdout
    assert "Traceback" not in done.stderr


def test_errors_survive_pickling():
    for error in (avrare.UsageError("a", "b"), avrare.PluginError("a"), avrare.ScenarioError([("m", "h")])):
        copy = pickle.loads(pickle.dumps(error))
        assert type(copy) is type(error)
        assert copy.lines() == error.lines()
