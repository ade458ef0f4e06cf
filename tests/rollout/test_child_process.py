"""First runs of a system in a child process: which answer counts, and what a crash there says."""

import ctypes
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import time
import traceback

import pytest

from avrare.rollout import child_process
from avrare.rollout.child_process import SystemCrashed, run_guarded, run_here

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux alone")


@pytest.fixture(autouse=True)
def _forking(monkeypatch):
    monkeypatch.setattr(child_process, "_may_fork", True)


@pytest.fixture
def system():
    """Return a system of a kind that has not run anywhere."""
    return type("Fresh", (), {})()


def crash():
    ctypes.string_at(0)


def test_the_answer_is_that_of_a_child(system):
    assert run_guarded("a test", system, os.getpid) != os.getpid()


def test_a_kind_that_runs_here_has_no_child(system):
    run_here(type(system)())
    assert run_guarded("a test", system, os.getpid) == os.getpid()
    system.part = type("Part", (), {})()
    assert run_guarded("a test", system, os.getpid) != os.getpid(), "with other parts it is of another kind"


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (crash, r"\(SIGSEGV\) in a test, at .*test_child_process.py:\d+ in crash\n"),
        (lambda: os._exit(3), r"\(exit code 3\) in a test\n"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), r"\(killed, or out of memory\) in a test\n"),
    ],
)
def test_a_crash_is_an_error_that_names_its_place(system, end, words):
    with pytest.raises(SystemCrashed, match=words) as caught:
        run_guarded("a test", system, end)
    assert caught.value.exit_code == 6
    assert caught.value.__context__ is None


def test_a_crash_is_seen_through_a_process_that_the_system_has_started(system, monkeypatch):
    monkeypatch.setattr(child_process, "_CHILD_SECONDS", 0.5)

    def start_and_crash():
        if os.fork() == 0:  # it holds the pipe open
            time.sleep(60.0)
            os._exit(0)
        crash()

    with pytest.raises(SystemCrashed, match="SIGSEGV"):
        run_guarded("a test", system, start_and_crash)


def test_an_exception_is_raised_here_with_its_place(system):
    with pytest.raises(ZeroDivisionError) as caught:
        run_guarded("a test", system, lambda: 1 / 0)
    assert traceback.extract_tb(caught.value.__traceback__)[-1].filename == __file__


def test_a_child_that_hangs_is_replaced_by_this_process(system, monkeypatch):
    monkeypatch.setattr(child_process, "_CHILD_SECONDS", 0.1)
    home = os.getpid()

    def hang_elsewhere():
        if os.getpid() != home:
            time.sleep(60.0)
        return os.getpid()

    assert run_guarded("a test", system, hang_elsewhere) == home
    monkeypatch.setattr(child_process, "_CHILD_SECONDS", 60.0)
    assert run_guarded("a test", system, hang_elsewhere) == home, "no other child hangs"


def test_after_a_child_that_hangs_none_is_forked(system, monkeypatch):
    monkeypatch.setattr(child_process, "_IDLE_SECONDS", 0.2)
    home = os.getpid()
    assert run_guarded("a test", system, lambda: os.getpid() == home or time.sleep(60.0)) is True
    assert run_guarded("a test", type("Other", (), {})(), os.getpid) == home


def test_a_child_does_not_talk_to_the_other_end_of_a_connection(system):
    here, there = multiprocessing.Pipe()
    there_socket, here_socket = socket.socketpair()

    def talk():
        here.send(os.getpid())
        here_socket.send(b"x")
        return os.getpid()

    assert run_guarded("a test", system, talk) == os.getpid()
    assert there.recv() == os.getpid()
    assert not there.poll(0.1)
    assert there_socket.recv(10) == b"x"


def test_systems_with_other_functions_or_texts_are_of_another_kind(system):
    def first():
        return 1

    def second():
        return 2

    system.part = type("Part", (), {})()
    for name, value in (("act", first), ("act", second), ("model", "a"), ("model", "b")):
        setattr(system.part, name, value)
        assert run_guarded("a test", system, os.getpid) != os.getpid()
        run_here(system)
        assert run_guarded("a test", system, os.getpid) == os.getpid()


def test_what_the_system_has_started_ends_with_the_child(system):
    started = run_guarded("a test", system, lambda: subprocess.Popen(["sleep", "60"]).pid)
    for _ in range(100):
        if not _is_alive(started):
            return
        time.sleep(0.05)
    raise AssertionError("it is still there")


def _is_alive(process):
    try:
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(") ")[2][0] != "Z"
    except FileNotFoundError:
        return False


PROGRAM = """
import warnings
from avrare.rollout.child_process import run_guarded

def speak():
    print("spoken", flush=True)
    warnings.warn("heard")
    return 5

print("begin")
print(run_guarded("a test", object(), speak))
"""


def test_nothing_is_printed_twice():
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["begin", "spoken", "5"]
    assert done.stderr == ""


def test_a_crash_has_its_place_though_a_library_has_taken_the_signal():
    script = (
        "import ctypes, faulthandler\n"
        "from avrare.rollout.child_process import run_guarded\n"
        "faulthandler.enable()\n"
        "ctypes.CDLL(None).signal(11, 0)\n"
        "run_guarded('the replay', object(), lambda: ctypes.string_at(0))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "(SIGSEGV) in the replay, at <string>:5 in <lambda>" in done.stderr
