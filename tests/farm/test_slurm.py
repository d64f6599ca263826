"""The job array for SLURM, run as SLURM runs it: a process a task, side by side, told before its time is up."""

import os
import re
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from holopath_addon.cli.template_command import FILES
from tests.farm import scenes
from tests.patience import NEVER

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "holopath_addon" / "farm" / "templates" / FILES["slurm"]
ARRAY_JOB = 70


class Slurm:
    """A stand-in for `sbatch` and `scontrol requeue`, for a script in a folder, with the programs in its `bin`."""

    def __init__(self, folder):
        self.folder, self.bin, self.requeued = folder, folder / "bin", folder / "requeued"
        self.bin.mkdir()
        self.program("scontrol", f'echo "$@" >> "{self.requeued}"')

    def program(self, name, text):
        path = self.bin / name
        path.write_text(f"#!/bin/bash\n{text}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)

    def start(self, script, task, words, restarts=0):
        """A task of the array. The last one has the array's own number, as in SLURM."""
        request = dict(re.findall(r"^#SBATCH --([\w-]+)=(\S+)", script.read_text(), re.MULTILINE))
        last = int(request["array"].split("-")[1])
        more = {
            "PATH": f"{self.bin}:{os.environ['PATH']}",
            "SLURM_ARRAY_JOB_ID": str(ARRAY_JOB),
            "SLURM_ARRAY_TASK_ID": str(task),
            "SLURM_JOB_ID": str(ARRAY_JOB if task == last else ARRAY_JOB + 1 + task),
            "SLURM_CPUS_PER_TASK": request["cpus-per-task"],
        }
        if restarts:
            more["SLURM_RESTART_COUNT"] = str(restarts)
        return subprocess.Popen(
            ["bash", script, *map(str, words)],
            cwd=self.folder,
            env=os.environ | more,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )


@pytest.fixture
def slurm(tmp_path):
    return Slurm(tmp_path)


@pytest.fixture
def script(tmp_path):
    """The template as a user sets it: two tasks on a processor each."""
    text = SCRIPT.read_text()
    lines = re.search(r"^frames=\(.*?\n\)", text, re.MULTILINE | re.DOTALL)[0]
    text = text.replace(lines, "frames=(\n    1,2\n    3-6\n)").replace("--array=0-3", "--array=0-1")
    path = tmp_path / "slurm.sh"
    path.write_text(text.replace("--cpus-per-task=8", "--cpus-per-task=1"))
    return path


def test_what_a_task_runs(slurm, script):
    slurm.program("holopath", 'printf "%s\\n" "$@" "threads $HOLOPATH_THREADS $OMP_NUM_THREADS"; exit 3')
    task = slurm.start(script, 1, ["my scene.blend", "out dir", "--focus", "0.5m, 2m"])
    described, _ = task.communicate(timeout=NEVER)
    assert described.splitlines() == [
        *("render", "my scene.blend", "--out", "out dir", "--frame-range", "3-6"),
        *("--focus", "0.5m, 2m", "threads 1 1"),
    ]
    assert task.returncode == 3 and not slurm.requeued.exists()


@pytest.mark.parametrize(
    ("task", "words", "says"),
    [
        (2, ["a.blend", "out"], r"slurm.sh: --array has a task 2, and frames 2 lines: let --array be 0-1\."),
        (0, ["a.blend"], "usage: sbatch slurm.sh SCENE.blend OUT"),
    ],
)
def test_what_is_wrong_is_said(slurm, script, task, words, says):
    slurm.program("holopath", "echo it ran")
    process = slurm.start(script, task, words)
    described, _ = process.communicate(timeout=NEVER)
    assert process.returncode != 0 and re.search(says, described) and "it ran" not in described


@pytest.mark.parametrize(
    ("number", "restarts", "requeued"),
    [(signal.SIGUSR1, 0, True), (signal.SIGUSR1, 20, False), (signal.SIGTERM, 0, False)],
)
def test_stopped_before_its_time_is_up(slurm, script, number, restarts, requeued):
    """It clears away, and then starts again, but not for ever, and not where the user canceled it."""
    slurm.program(
        "holopath", 'trap "sleep 0.2; echo cleared; exit 1" TERM; echo begun; while :; do sleep 0.05; done'
    )
    task = slurm.start(script, 1, ["a.blend", "out"], restarts)
    assert task.stdout.readline() == "begun\n"
    task.send_signal(number)
    described, _ = task.communicate(timeout=NEVER)
    assert described == "cleared\n" and task.returncode == 1
    assert slurm.requeued.exists() == requeued
    if requeued:
        assert slurm.requeued.read_text() == f"requeue {ARRAY_JOB}_1\n"


@pytest.mark.slow
def test_the_animation_is_whole(slurm, script):
    """Two tasks in one folder, of which one runs out of time after its first frame and is started again."""
    bpy = pytest.importorskip("bpy")
    scenes.room(bpy, frames=6)
    bpy.ops.wm.save_as_mainfile(filepath=str(slurm.folder / "my scene.blend"), check_existing=False)
    slurm.program(
        "holopath",
        f'cd "{slurm.folder}"; export PYTHONPATH="{ROOT}"; exec {sys.executable} -m holopath_addon "$@"',
    )
    words = ["my scene.blend", "out", "--resolution", "32x32", "--frames", "1", "--quality", "preview"]
    words += ["--method", "fast", "--focus", "0.5m"]
    first, second = (slurm.start(script, task, words) for task in (0, 1))
    heard = ""
    while "Saved: " not in heard:
        line = second.stdout.readline()
        assert line, heard
        heard += line
    second.send_signal(signal.SIGUSR1)
    described, _ = second.communicate(timeout=NEVER)
    assert second.returncode == 1 and "Canceled" in described, described
    assert slurm.requeued.read_text() == f"requeue {ARRAY_JOB}_1\n"
    again = slurm.start(script, 1, words, restarts=1)
    for task in (first, again):
        described, _ = task.communicate(timeout=NEVER)
        assert task.returncode == 0, described
    frames = [f"frame_{number:04d}" for number in range(1, 7)]
    assert sorted(os.listdir(slurm.folder / "out")) == [*frames, "job.json", "light"]
    assert all((slurm.folder / "out" / frame / "report.json").is_file() for frame in frames)
