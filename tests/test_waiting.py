"""How long cancel waits in each stage, by the process's own clock while another process keeps the processor busy."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WORST = 1.0  # second of the process's own time, with one thread
BUSY = "while True: pass"
STAGES = """
import json, sys, time
import numpy as np
from benchmarks.scenes import FOV, GREEN, Scenes
from holopath_addon import engine
from holopath_addon.engine.scene import variants
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

variants.activate()

class Waits:
    '''Longest time from one look at cancel to the next, by what was told last.'''
    def __init__(self):
        self.worst, self.last, self.at = {}, "begin", time.process_time()
    def __call__(self, done, message):
        now, name = time.process_time(), message.split(",")[0]
        self.worst[self.last] = max(self.worst.get(self.last, 0.0), now - self.at)
        self.last, self.at = name, now

def waits(work):
    work(lambda done, message: None)  # which compiles
    found = Waits()
    work(found)
    found(1.0, "end")
    return found.worst

def cancelled(work, when):
    '''Own time from cancel to the end.'''
    at = []
    def progress(done, message):
        if message.startswith(when):
            at.append(time.process_time())
            raise engine.Cancelled
    try:
        work(progress)
    except engine.Cancelled:
        return time.process_time() - at[0]

box, camera = Scenes().closed_box(), engine.Camera(np.eye(4), FOV)
hologram = engine.Hologram(96, 96, 8e-6, (GREEN,), 0.5e-3, 2e-3)
found = {}
for method in ("full", "fast"):
    settings = engine.Settings(frames=4, method=method, fixed={"passes": 128})
    found[method] = waits(lambda progress: engine.render(box, camera, hologram, settings, progress=progress))
chance = np.random.default_rng(0)
data = (chance.normal(size=(8, 1, 384, 384)) + 1j * chance.normal(size=(8, 1, 384, 384))).astype(np.complex64)
large = engine.Hologram(384, 384, 8e-6, (GREEN,), -4e-3, 1e-3, near=0.5)
field = engine.WaveField(data, large, camera, 0.5)
encode = lambda progress: engine.encode(field, "joint", progress, max_steps=2)
found["encode"] = waits(encode)
found["refocus"] = waits(lambda progress: engine.reconstruct(field, [0.5, 1.0], progress=progress))

one, few = engine.Settings(frames=1), engine.Hologram(256, 256, 8e-6, (GREEN,), 0.5e-3, 2e-3)
seen = engine.render(box, camera, few, one)
found["few"] = waits(lambda progress: pipeline.encode(seen, Encoding("refine"), progress, box, one, max_steps=3))
lens = engine.Hologram(384, 384, 8e-6, (GREEN,), optics=engine.Optics(lens=engine.Lens(0.1)))
behind = engine.WaveField(data, lens, camera, 0.5)
focus = [float(behind.mapping.z_to_depth(z)) for z in (0.0, 1e-3)]
found["lens"] = waits(lambda progress: engine.encode(behind, "joint", progress, max_steps=2))
found["refocus behind a lens"] = waits(lambda progress: engine.reconstruct(behind, focus, progress=progress))
found["cancelled"] = {when: cancelled(encode, when) for when in ("Phases", "Views", "All frames")}
print(json.dumps(found))
"""


@pytest.mark.slow
def test_cancel_is_heard_within_a_second(backend):
    """In each stage; and what is done after it."""
    busy = subprocess.Popen([sys.executable, "-c", BUSY])
    try:
        environment = {**os.environ, "HOLOPATH_THREADS": "1", "OMP_NUM_THREADS": "1"}
        done = subprocess.run(
            [sys.executable, "-c", STAGES], cwd=ROOT, env=environment, capture_output=True, text=True
        )
    finally:
        busy.kill()
        busy.wait()
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    long = {(work, stage): s for work, waits in found.items() for stage, s in waits.items() if s > WORST}
    assert not long
    assert "Radiance" in found["full"] and "Baking light in view" in found["fast"]
    # light is found again, then targets
    assert {"Radiance", "Wave tracing", "The frame"} <= set(found["few"])
    assert None not in found["cancelled"].values()
