"""The console script is the command line."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

CAPE = [sys.executable, "-m", "cape"]


def run(*arguments):
    return subprocess.run([*CAPE, *arguments], capture_output=True, text=True, timeout=120)


def test_exit_codes_and_streams(tmp_path):
    version = run("--version")
    assert (version.returncode, version.stderr) == (0, "")
    assert version.stdout.startswith("cape ")
    wrong = run("undress")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "undress" in wrong.stderr
    missing = run("info", str(tmp_path / "nowhere"))
    assert (missing.returncode, missing.stdout) == (1, "")
    assert "nowhere" in missing.stderr


def test_the_script_is_installed():
    script = shutil.which("cape", path=os.path.dirname(sys.executable))
    if script is None:
        pytest.skip("the package is not installed by pip")
    version = subprocess.run([script, "--version"], capture_output=True, text=True, timeout=60)
    assert version.stdout == run("--version").stdout


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_ends_a_command(tmp_path):
    arguments = ["data", "synth", "--out", str(tmp_path / "raw"), "--subjects", "50"]
    with subprocess.Popen([*CAPE, *arguments], stderr=subprocess.DEVNULL) as command:
        deadline = time.monotonic() + 60
        while not (tmp_path / "raw").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        command.send_signal(signal.SIGINT)
        assert command.wait(timeout=30) == -signal.SIGINT
