"""Ctrl-C at any time ends a command, which says so."""

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes, errno, os, signal, threading, time
from dune_rl.commands.command_line import run_command
from dune_rl.commands.pages import HelpPage

def at_once(parsed):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60.0)

@ctypes.CFUNCTYPE(None)
def called_from_c():
    os.kill(os.getpid(), signal.SIGNAL)
    time.sleep(60.0)

def in_a_callback(parsed):
    called_from_c()
    time.sleep(60.0)
    print("went on")

def in_a_callback_without_which_it_fails(parsed):
    called_from_c()
    raise RuntimeError("no compiled object yet")

def in_a_library_that_turns_it_into_an_error(parsed):
    try:
        os.kill(os.getpid(), signal.SIGNAL)
        time.sleep(60.0)
    except BaseException as stopped:
        raise SystemError("returned a result with an exception set") from stopped

def with_a_thread_on_a_full_disk(parsed):
    def write():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), b"events")

    thread = threading.Thread(target=write)
    thread.start()
    thread.join()

run_command(HelpPage("A command.", (), (), ""), BODY)
"""


def run(body: str, signal: str = "SIGINT") -> subprocess.CompletedProcess[str]:
    program = PROGRAM.replace("BODY", body).replace("SIGNAL", signal)
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)


def test_an_interruption_is_said() -> None:
    ended = run("at_once")
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "Interrupted\n")


def test_a_thread_that_meets_a_full_disk_says_so_in_a_line() -> None:
    ended = run("with_a_thread_on_a_full_disk")
    assert ended.stderr == "cannot write events: the disk is full; choose another place\n"


@pytest.mark.parametrize(("name", "code", "said"), [("SIGINT", 130, "Interrupted\n"), ("SIGTERM", 143, "")])
def test_what_a_callback_from_c_loses_is_repeated(name: str, code: int, said: str) -> None:
    ended = run("in_a_callback", name)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", said)


@pytest.mark.parametrize(("name", "code", "said"), [("SIGINT", 130, "Interrupted\n"), ("SIGTERM", 143, "")])
def test_a_signal_that_a_library_turns_into_an_error_is_one(name: str, code: int, said: str) -> None:
    ended = run("in_a_library_that_turns_it_into_an_error", name)
    assert (ended.returncode, ended.stderr) == (code, said)


@pytest.mark.parametrize(("name", "code", "said"), [("SIGINT", 130, "Interrupted\n"), ("SIGTERM", 143, "")])
def test_what_fails_for_want_of_an_interrupted_callback_is_no_fault(name: str, code: int, said: str) -> None:
    ended = run("in_a_callback_without_which_it_fails", name)
    assert (ended.returncode, ended.stderr) == (code, said)
