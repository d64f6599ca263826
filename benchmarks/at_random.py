"""Whether anything differs from Cycles without a word: scenes of whatever Blender can say, drawn at random.

python -m benchmarks at_random scenes=500 first=0
"""

import sys
import time

import bpy
import numpy as np

from .exporter import BLOCK, unbiased_cycles
from .features.anything import any_scene
from .stage import Stage

MAX_DIFFERENCE = 0.05  # mean over blocks, of the picture's mean
SIDE, DEPTH = 48, 8
SAMPLES = (32, 256, 1024)
BAKED = "baked to a texture"  # which is no difference


def run(scenes: int = 500, first: int = 0) -> str:
    """Table of the scenes that differ; counts of those that agree, are noted, and differ silently.

    Parameters
    ----------
    scenes : int
    first : int
        Seed of the first one.
    """
    begun, counts, silent = time.perf_counter(), {"agree": 0, "noted": 0, "silent": 0, "refused": 0}, []
    for seed in range(first, first + scenes):
        verdict, words = judge(seed)
        counts[verdict] += 1
        if verdict in ("silent", "refused"):
            silent.append(f"  {seed:5d} {verdict:8s} {words}")
            print(silent[-1], file=sys.stderr, flush=True)
    summary = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    return "\n".join([f"at random: {summary} of {scenes}; {time.perf_counter() - begun:.0f} s", *silent])


def judge(seed: int) -> tuple[str, str]:
    """Verdict on a scene, ``agree``, ``noted``, ``silent`` or ``refused``, and its figures."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    stage = Stage()
    any_scene(stage, seed)
    try:
        exported = stage.export((SIDE, SIDE))
    except Exception as error:  # a crash of the exporter is a finding, too
        return "refused", f"{type(error).__name__}: {error}"
    notes = [f"{note.feature}: {note.effect}" for note in exported.notes if note.effect != BAKED]
    difference = brightness = 0.0
    for samples in SAMPLES:
        options = dict(resolution=(SIDE, SIDE), spp=samples, depth=DEPTH)
        ours, theirs = stage.mitsuba(**options, exported=exported), unbiased_cycles(stage, 0, **options)
        blocks = [
            image.reshape(SIDE // BLOCK, BLOCK, SIDE // BLOCK, BLOCK, 3).mean((1, 3))
            for image in (ours, theirs)
        ]
        difference = float(np.abs(blocks[0] - blocks[1]).mean() / max(blocks[1].mean(), 1e-6))
        brightness = float(blocks[0].mean() / max(blocks[1].mean(), 1e-6))
        if difference <= MAX_DIFFERENCE:
            return "agree", ""
        if notes:
            break
    words = f"mean {difference:.1%}, brightness {brightness:.3f}"
    return ("noted", "; ".join(notes)) if notes else ("silent", words)
