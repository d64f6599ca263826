"""`make test-cuda` and `make bench-cuda`: what they run on an NVIDIA card, and how they refuse without one."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from holopath_addon.engine.scene import variants
from tests.patience import NEVER

ROOT = Path(__file__).parents[1]
CARD = variants._cuda_device()[0]


def run(*words, backend=variants.CUDA):
    """A Python of its own: what is loaded stays in a process."""
    return subprocess.run(
        [sys.executable, "-m", *words],
        cwd=ROOT,
        env=os.environ | {"HOLOPATH_BACKEND": backend},
        capture_output=True,
        text=True,
        timeout=NEVER,
        check=False,
    )


@pytest.mark.skipif(CARD, reason="this machine has an NVIDIA card")
@pytest.mark.parametrize("words", [("pytest", "tests/test_cuda.py"), ("benchmarks", "card", "64x36", "2")])
def test_without_a_card_one_sentence_and_status_2(words):
    refused = run(*words)
    assert refused.returncode == 2
    assert re.fullmatch(r"(Exit: )?cuda_ad_rgb cannot be used: .*\.", refused.stderr.strip())
    assert refused.stdout == ""


def recipe(target):
    """Words of a target's command in the Makefile."""
    text = (ROOT / "Makefile").read_text("utf-8")
    folders = re.search(r"(?m)^CUDA_TESTS := (.*)", text)[1]
    command = re.search(rf"(?m)^{target}: \$.*\n\t(.*)", text)[1].replace("$(CUDA_TESTS)", folders)
    return [word.strip("'") for word in re.findall(r"'[^']*'|\S+", command)]


@pytest.mark.slow
def test_what_is_run_on_a_card():
    """Tests of each room of the engine, of the exporter and of other methods, and those for a card alone."""
    _, dash, *words = recipe("test-cuda")
    found = run(*words, "--collect-only", "-q")
    assert dash == "-m" and found.returncode == 0, found.stdout[-2000:]
    names = [line.partition("[")[0] for line in found.stdout.splitlines() if "::" in line]
    assert f"{Path(__file__).relative_to(ROOT)}::test_fields_are_those_of_llvm" in names
    rooms = {"scene", "waves", "light", "tracing", "encoding", "planning", "viewing", "baselines"}
    assert {f"tests/engine/{room}" for room in rooms} | {"tests/export"} <= {
        str(Path(name.partition("::")[0]).parent) for name in names
    }
    assert not any("test_what_is_run_on_a_card" in name for name in names)


@pytest.mark.slow
def test_the_benchmark_in_small():
    """On whatever computes here: stages of the render, what was foretold, pictures and phases, and both speeds."""
    told = run("benchmarks", "card", "64x36", "2", "dpac,sgd,none_such", "steps=1", backend="")
    assert told.returncode == 1, told.stderr
    assert (
        "64x36, 2 frames: none_such: There is no encoding 'none_such'" in told.stderr
    )  # and the rest is kept
    assert "64 x 36" in told.stdout
    for row in (
        "radiance",
        "wave tracing",
        "propagation",
        "reconstruction",
        r"two FFTs, \d+ moves",
        "dpac",
    ):
        assert re.search(rf"(?m)^  {row} +\d+\.\d\d s$", told.stdout)
    assert re.search(r"(?m)^  sgd .* dB; sgd 3 steps of \d\.\d+ s$", told.stdout)
    assert re.search(r"(?m)^  foretold: .*wave tracing \d+\.\d\d s", told.stdout)
    for row in ("wave rays", "ray_intersect loop"):
        assert float(re.search(rf"(?m)^  {row} +(\d+) Mray/s$", told.stdout)[1]) >= 0


RENDER = """
import pickle, sys
from pathlib import Path
import bpy
import numpy as np
from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.export import export_scene

name, plan, out = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
demo.build(name)
found = export_scene(bpy.context.evaluated_depsgraph_get(), (96, 96))
view = found.scene, found.camera, engine.Hologram(96, 96, 8e-6)
settings = engine.Settings(frames=3, method="full", quality="preview")
if not plan.exists():
    plan.write_bytes(pickle.dumps(engine.plan(*view, settings)))
np.save(out, engine.render(*view, settings, pickle.loads(plan.read_bytes())).data)
"""


def field_of(scene, folder, backend):
    """As the first backend that is asked plans it: what is worth its time is another question on each."""
    words = [sys.executable, "-c", RENDER, scene, str(folder / "plan"), str(folder / f"{backend}.npy")]
    done = subprocess.run(
        words, cwd=ROOT, env=os.environ | {"HOLOPATH_BACKEND": backend}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return np.load(folder / f"{backend}.npy")


@pytest.mark.cuda
@pytest.mark.parametrize("scene", ["planes", "suzanne", "box"])
def test_fields_are_those_of_llvm(scene, tmp_path):
    """The same rays and random numbers: only roundings differ, and paths that an edge sends another way."""
    pytest.importorskip("bpy")
    ours, theirs = (field_of(scene, tmp_path, name) for name in (variants.CUDA, variants.LLVM))
    difference = np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)
    assert difference < 0.02
