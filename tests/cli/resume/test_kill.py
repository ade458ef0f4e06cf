"""A run that is killed, interrupted or left without room goes on, and ends as if nothing had been."""

import os
import resource
import signal
import time

import numpy as np
import pytest

SLOW = {"AVRARE_TOY_PAUSE": "0.004"}


def wait_for(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to that"
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "seed"), [("mc", 5), ("ams", 6)])
def test_kill_minus_nine_at_random_moments(night, estimator, seed):
    scenario = night.scenario(estimator)
    night.run(scenario, "--out", "whole")
    (night.folder / "torn").mkdir()
    random = np.random.default_rng(seed)
    for life in range(5):
        process = night.start(scenario, "--out", "torn", "--resume", "--workers", 1 + life % 2, **SLOW)
        time.sleep(random.uniform(0.3, 1.6))
        process.kill()
        process.communicate()
    night.run(scenario, "--out", "torn", "--resume")
    assert night.result("torn") == night.result("whole"), f"seed {seed}"
    assert not (night.folder / "torn" / "checkpoint").exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("workers", [1, 2])
def test_a_signal_ends_the_run_after_the_chunk_in_hand(night, number, workers):
    scenario = night.scenario()
    night.run(scenario, "--out", "whole")
    process = night.start(scenario, "--out", "a folder", "--workers", workers, **SLOW)
    wait_for(lambda: len(night.saved("a folder")) >= 3)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2, err
    assert "stopping after the current chunk" in err
    many = len(night.saved("a folder"))
    assert f"interrupted, {many} chunks are saved\nhint: resume with avrare run --out 'a folder' --res" in err
    assert 3 <= many < 40
    night.run("--out", "a folder", "--resume")
    assert night.result("a folder") == night.result("whole")


@pytest.mark.slow
@pytest.mark.parametrize("chunks", [0, 3])
def test_ctrl_c_with_workers_behaves_the_same(night, chunks):
    """Interrupt at any time: with no chunk saved the workers are just starting."""
    process = night.start(night.scenario(), "--out", "torn", "--workers", 2, **SLOW)
    wait_for(lambda: (night.folder / "torn" / "checkpoint" / "walk").exists())
    wait_for(lambda: len(night.saved("torn")) >= chunks)
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "\nstopping after" in err  # below the time left, if a chunk told it
    assert "Traceback" not in err
    assert "KeyboardInterrupt" not in err


@pytest.mark.slow
def test_a_signal_to_the_program_and_its_group_counts_once(night):
    """Send the signal as ``timeout`` does: twice to the program, once to each worker."""
    process = night.start(night.scenario(), "--out", "torn", "--workers", 2, AVRARE_TOY_PAUSE="0.05")
    wait_for(lambda: len(night.saved("torn")) >= 2)
    many = len(night.saved("torn"))
    process.send_signal(signal.SIGTERM)
    time.sleep(0.02)
    os.killpg(process.pid, signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2, err
    assert len(night.saved("torn")) > many, "the chunks in hand are lost"
    assert "Traceback" not in err


@pytest.mark.slow
def test_the_second_signal_ends_the_run_at_once(night):
    process = night.start(night.scenario(), "--out", "torn", "--workers", 2, AVRARE_TOY_PAUSE="5")
    wait_for(lambda: (night.folder / "torn" / "checkpoint" / "walk").exists())
    time.sleep(2.0)  # a chunk takes 100 seconds
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 2
    assert "0 chunks are saved" in err


@pytest.mark.slow
def test_a_disk_that_fills_up_loses_only_the_chunks_in_hand(night):
    scenario = night.scenario()
    night.run(scenario, "--out", "whole")
    process = night.start(scenario, "--out", "torn", **SLOW)
    wait_for(lambda: len(night.saved("torn")) >= 3)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (500, 500))
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    hint = "free some disk space; completed chunks are saved: resume with avrare run --out torn --resume"
    assert f"cannot save: File too large\nhint: {hint}\n" in err
    assert not [path for path in (night.folder / "torn").rglob("*") if path.name.startswith(".")]
    assert len(night.saved("torn")) >= 3
    night.run("--out", "torn", "--resume")
    assert night.result("torn") == night.result("whole")


def test_workers_do_not_outlive_a_killed_parent(night):
    process = night.start(night.scenario(), "--out", "torn", "--workers", 2, **SLOW)
    wait_for(lambda: len(night.saved("torn")) >= 1)
    process.kill()
    process.communicate(timeout=60)  # raises while anybody holds its pipes, the workers among them
    assert process.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_a_dead_worker_is_replaced(night):
    scenario = night.scenario()
    night.run(scenario, "--out", "whole")
    trap = night.folder / "trap"
    trap.touch()
    _, err = night.run(scenario, "--out", "mended", "--workers", 2, AVRARE_TOY_DIE=str(trap))
    assert "note: workers died: 1; their chunks were run again" in err
    assert night.result("mended") == night.result("whole")
