"""Choice of the encoding for the seconds available."""

import json
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from holopath_addon import engine

COSTS = {
    "sgd": 1.0,  "joint": 8.0, "look": 0.0125, "light": 2.0, "rays": 0.4, "frame": 0.0125, "step": 0.1
}  # fmt: skip
SET = 0.4 + 24 * (0.0125 + 0.0125)  # seconds
MEMORY = {"sgd": 40e6, "joint": 90e6, "refine": 200e6}


def chosen(encoding="auto", seconds=None, costs=COSTS, traversals=3, co_traced=0, eyebox=None, **settings):
    plan = planned(costs, traversals, **settings)
    return engine.plan_encoding(plan, encoding, seconds, co_traced, eyebox)


def planned(costs=COSTS, traversals=3, **settings):
    """Attributes of a plan that decide about its encodings."""
    from holopath_addon.engine.planning.planner import resolved

    requested = engine.Settings(**settings)
    kinds = {"requested": requested, "settings": resolved(requested)}
    return SimpleNamespace(phases=costs, phases_memory=MEMORY, traversals=traversals, **kinds)


def test_more_seconds_go_towards_more_frames():
    """Estimates fit into the limit, and steps have most of it; with one traversal the clock ends the frames."""
    assert [chosen(seconds=seconds, traversals=1).frames for seconds in (4, 9, 50)] == [0, 24, 176]
    found = {seconds: chosen(seconds=seconds) for seconds in (1, 4, 8, 20, 50, 1000)}
    assert [each.method for each in found.values()] == ["sgd", "joint", *["refine"] * 4]
    frames = [each.frames for each in found.values()]
    assert frames == sorted(frames) and frames[:3] == [0, 0, 8] and frames[-1] == 176
    for seconds, each in found.items():
        assert each.seconds <= seconds and each.steps in (0, 70)
        if each.frames > 8:
            assert COSTS["light"] + each.frames / 24 * SET <= 0.4 * seconds


def test_co_traced_frames_need_no_paths():
    """Fewer seconds suffice, and more frames come only where there is time for paths."""
    found = {seconds: chosen(seconds=seconds, co_traced=24, traversals=1) for seconds in (2, 3, 5, 20)}
    assert [(each.method, each.frames) for each in found.values()] == [
        ("refine", 24),
        ("refine", 24),
        ("refine", 24),
        ("refine", 192),
    ]
    assert chosen(co_traced=24).frames == 96
    assert chosen().seconds - chosen(co_traced=24).seconds == pytest.approx(COSTS["rays"])
    assert (
        chosen(co_traced=24, seconds=9, traversals=3).frames == 24
    )  # 48 would be there after four tenths of it
    assert chosen(co_traced=120).frames == 120
    # of few frames all come along: rays by the set, and no paths again
    all_of_them = COSTS["light"] + COSTS["rays"]
    assert chosen(frames=1).seconds - chosen(frames=1, co_traced=96).seconds == pytest.approx(all_of_them)


@pytest.mark.parametrize(
    ("method", "seconds", "settings", "size", "count"),
    [
        ("auto", None, {}, 256, 24),
        ("refine", 1, {}, 256, 24),
        ("auto", 1, {}, 256, 24),  # for the whole pupil alone
        ("auto", 0.5, {}, 256, 0),  # is sgd
        ("joint", None, {}, 256, 0),
        ("none", None, {}, 256, 0),
        ("auto", None, {"despeckle": 20}, 256, 0),
        ("auto", None, {"phase_field": "random"}, 256, 0),
        ("auto", None, {"method": "point"}, 256, 0),
        ("auto", None, {"radiance": "ray"}, 256, 0),
        ("auto", None, {"frames": 1}, 256, 96),
        ("refine", None, {"frames": 3}, 128, 192),
        ("refine", 20, {"frames": 3}, 256, 24),  # the clock says how many there are in the end
        ("auto", None, {"frames": 1}, 512, 24),  # all would take 600 MB
        ("auto", None, {"frames": 1, "phase_field": "designed"}, 256, 0),
        ("auto", None, {}, 2048, 0),  # would take 2.4 GB
    ],
)
def test_number_of_co_traced_frames(method, seconds, settings, size, count):
    hologram = engine.Hologram(size, size, 8e-6)
    assert engine.extra_frame_count(planned(traversals=1, **settings), hologram, method, seconds) == count


@pytest.mark.parametrize("given", [{}, {"seconds": 3}, {"seconds": 3, "speckle": 0.1}])
def test_advice_is_what_the_advised_seconds_bring(given):
    """With the advised seconds there are more frames and as many steps as promised, and no further advice."""
    before = chosen(**given)
    assert before.method == ("joint" if "seconds" in given else "refine")
    assert before.advice.startswith(f"{before.better:.0f} s of encoding would gain")
    after = chosen(**{**given, "seconds": before.better})
    assert after.method == "refine" and after.frames > before.frames and after.advice == ""
    before_frames = 22 if "speckle" in given else 8
    frames = COSTS["light"] + math.ceil(after.frames / 24) * COSTS["rays"] + after.frames * 0.025
    steps = (after.seconds - COSTS["sgd"] - 3 * before_frames * COSTS["look"] - frames) / COSTS["step"]
    assert steps >= max(100, 4 * before.steps) - 1e-6
    assert "seconds" not in given or "to be worth" in before.reason


def test_without_a_limit():
    """Without a time limit results are the same on all machines, as no measured time decides."""
    slow = {name: 9 * cost for name, cost in COSTS.items()}
    for costs in (COSTS, slow):
        assert [
            (e.method, e.frames, e.steps) for e in (chosen(costs=costs), chosen(costs=costs, method="full"))
        ] == [
            ("refine", 96, 100),
            ("refine", 192, 400),
        ]
    one = {"frames": 1, "phase_field": "designed"}
    assert chosen(**one).method == "sgd" and not chosen(**one).advice
    assert {chosen(**one, **more).method for more in ({"seconds": 50}, {"method": "full"})} == {"sgd"}
    assert chosen("refine", **one).method == "refine"  # as asked
    assert chosen().seconds == pytest.approx(1 + 0.3 + 2 + 4 * SET + 100 * 0.1)
    assert chosen("sgd").seconds == 1 and chosen("sgd", seconds=0.3).seconds == 0.3
    assert (
        chosen("refine").steps == 400 and chosen("refine", seconds=0.1).frames == 8
    )  # as asked, however short
    assert str(chosen("joint").decision) == "encoding: joint, about 8.0 s, 90 MB (as asked)"


def test_few_frames_begin_with_phases_that_are_hardly_random():
    """Few frames also use the whole pupil alone, unless an eyebox is requested; the reason says so."""
    found = {frames: chosen(frames=frames) for frames in (1, 2, 3, 5, 6, 7, 8)}
    assert {each.method for each in found.values()} == {"refine"}
    randomness = [each.randomness for each in found.values()]
    assert randomness[0] == 0 and randomness[:6] == sorted(randomness[:6]) and randomness[6] is None
    eyebox = [each.eyebox for each in found.values()]
    assert eyebox[:5] == [0] * 5 and 0 < eyebox[5] < eyebox[6] == 1  # no frame more shows much less
    assert [each.steps for each in found.values()] == [200] * 2 + [100] * 5
    assert [chosen(frames=frames, eyebox=1.0).steps for frames in (1, 3, 7, 8)] == [200, 200, 200, 100]
    # more steps would leave parts of the pupil dark, where there are enough frames to light them
    assert [chosen("refine", frames=frames).steps for frames in (1, 3, 7, 8)] == [400, 100, 100, 400]
    assert chosen("refine", frames=3, eyebox=1.0).steps == 400
    assert "randomness 0;" in found[1].reason and "as a whole" in found[1].reason
    wide = engine.plan_encoding(planned(traversals=1, frames=1, randomness=0.2), eyebox=0.5)
    assert (wide.randomness, wide.eyebox) == (
        0.2,
        0.5,
    ) and "in parts, too, with a weight of 0.5" in wide.reason
    parts = engine.plan_encoding(planned(traversals=1, frames=3), eyebox=1.0)
    assert parts.randomness == 1  # parts of the pupil see what random phases send there
    assert chosen(frames=1, seconds=0.5).randomness is None  # for there is no time for more frames
    assert chosen(frames=2, phase_field="designed").randomness is None


def test_few_frames_in_few_seconds():
    """Few steps towards few extra frames show more than any other encoding; without them all frames go together."""
    for frames in (1, 3):
        found = {seconds: chosen(frames=frames, seconds=seconds) for seconds in (0.5, 2, 5, 60)}
        assert [each.method for each in found.values()] == ["sgd", "joint", "refine", "refine"]
        assert found[0.5].randomness is None  # for there is no time
        assert len({each.randomness for each in found.values()} - {None}) == 1
        assert "up to 10 dB" in found[2].advice and "up to 5 dB" in found[5].advice and not found[60].advice
        assert ("more than 100 steps" in found[60].reason) == (frames == 3)
        assert (found[60].seconds < 30) == (frames == 3)
    assert chosen("joint", frames=3).randomness is None  # as asked, from the field's phases
    # other people's fields keep their phases, and phases that are random at the start take more steps
    assert chosen(frames=3, method="rgbd").randomness is None
    assert chosen(frames=3, seconds=2, eyebox=1.0).randomness is None


def test_many_frames_for_the_whole_pupil_alone_begin_as_few_do():
    """Only if that is asked for, and no phase field is; a render traces extra frames along, in few seconds, too."""
    found = chosen(frames=8, eyebox=0.0)
    assert (found.method, found.randomness, found.eyebox, found.steps) == ("refine", 0.1, 0, 100)
    assert "the pupil as a whole" in found.reason and found.seconds < chosen(frames=8).seconds
    assert chosen(frames=24, eyebox=0.0).randomness == 0.1 and chosen(frames=8, eyebox=0.1).randomness is None
    assert chosen(frames=8, eyebox=0.0, phase_field="designed").randomness is None
    assert chosen(frames=8, eyebox=0.0, seconds=30).randomness == 0.1
    designed = chosen(frames=8, eyebox=0.0, phase_field="designed")
    # whose frames are optimized one by one, too
    assert found.seconds < designed.seconds < chosen(frames=8).seconds
    assert "randomness 0.5, as asked" in chosen(frames=8, eyebox=0.0, randomness=0.5).reason
    plan, hologram = planned(frames=24), engine.Hologram(256, 256, 8e-6)
    counts = [engine.extra_frame_count(plan, hologram, "auto", 2.0, eyebox) for eyebox in (0.0, 1.0)]
    assert counts == [24, 0]


def test_few_seconds_of_eight_frames_go_to_the_whole_pupil():
    """They begin as few frames do where a designed field's phases would have fewer steps than by default."""
    enough = chosen(seconds=3, co_traced=24).better
    found = {seconds: chosen(seconds=seconds, co_traced=24) for seconds in (0.5, 1, 3, 0.9 * enough, enough)}
    assert [each.randomness for each in found.values()] == [None, 0.1, 0.1, 0.1, None]
    assert [each.eyebox for each in found.values()] == [1, 0, 0, 0, 1]
    short, long = found[3], found[0.9 * enough]
    assert (short.method, short.frames, short.seconds, short.steps) == ("refine", 24, 3, 70)
    assert "towards up to 24 extra frames" in str(short.decision)
    assert "the pupil as a whole" in short.reason and "up to 5 dB" in short.advice
    # more steps would take light away from parts of the pupil
    assert (long.frames, long.steps) == (24, 70) and long.seconds < 0.7 * enough
    assert "more than 70 such steps" in long.reason and long.advice.startswith(f"{enough:.0f} s")
    assert "all over the pupil" in long.advice
    # frames that take long are no reason to wait for them
    dear = {"costs": COSTS | {"rays": 30.0}, "co_traced": 24}
    long = chosen(seconds=3, **dear).better
    assert long < 30 and chosen(seconds=long, **dear).eyebox == 1 and not chosen(seconds=long, **dear).advice
    assert chosen(seconds=60, **dear | {"co_traced": 0}).steps == 70  # with eight frames, too
    assert chosen(seconds=0.9 * enough, co_traced=120).frames == 120
    assert chosen(seconds=0.9 * enough).frames == 24  # a stored field has none yet, and few show less
    assert chosen("refine", seconds=3, co_traced=24).reason == f"as asked; {short.reason}"
    for other in ({"frames": 16}, {"frames": 24}, {"phase_field": "designed"}, {"phase_field": "random"}):
        assert chosen(seconds=3, co_traced=24, **other).randomness is None, other
    assert chosen("joint", seconds=3, co_traced=24).randomness is None
    plan = planned()
    assert engine.plan_encoding(plan, "auto", 3, 24, 0.0).randomness == 0.1
    assert engine.plan_encoding(plan, "auto", 3, 24, 1.0).randomness is None  # as asked


def test_methods_without_more_frames():
    baseline = planned({}, method="rgbd")
    for seconds in (None, 100):
        found = engine.plan_encoding(baseline, "auto", seconds)
        assert found.method == "joint" and not found.frames
    with pytest.raises(engine.InvalidInput, match="Choose joint"):
        engine.plan_encoding(baseline, "refine")
    with pytest.raises(engine.InvalidInput, match="no encoding 'best'"):
        chosen("best")


def test_short_memory_is_reported(monkeypatch):
    from holopath_addon.engine import memory

    found = chosen("refine")
    assert (
        found.memory_bytes == MEMORY["refine"]
        and not found.memory_warnings()
        and not chosen("dpac").memory_bytes
    )
    monkeypatch.setattr(memory, "available", lambda: 100e6)
    assert "This encoding needs about" in found.memory_warnings()[0] and not chosen("joint").memory_warnings()
    monkeypatch.setattr(memory, "installed", lambda: 100e6)
    with pytest.raises(engine.InvalidInput, match="This encoding needs about .* this machine has"):
        found.memory_warnings()


def test_costs_of_a_real_plan(build, camera, small, monkeypatch):
    """Estimates are positive, and those of steps are proportional to the frames.

    The machine's speed is measured again every ten minutes, which may lie between two plans.
    """
    from holopath_addon.engine.planning import machine, survey

    monkeypatch.setattr(survey, "slowness", lambda folder: machine.Slowness(1.0, 1.0, 1.0))
    plans = [
        engine.plan(build.two_planes(build.diffuse), camera, small, engine.Settings(frames=n)) for n in (7, 8)
    ]
    one, many = (plan.phases for plan in plans)
    bytes_of = [plan.phases_memory for plan in plans]
    assert all(0 < few <= more for few, more in zip(*(each.values() for each in bytes_of), strict=True))
    assert set(one) == set(COSTS) and min(one.values()) > 0
    for name in ("sgd", "joint", "step"):
        assert many[name] == pytest.approx(8 / 7 * one[name])


def test_a_plan_of_another_version_is_refused(build, camera, small):
    """The caller plans again, as the costs have other names."""
    plan = engine.plan(build.two_planes(build.emissive), camera, small)
    values = plan.to_dict()
    assert engine.Plan.from_dict(values) == plan
    with pytest.raises(KeyError):
        engine.Plan.from_dict({**values, "phases": {"sgd": 1.0, "set": 2.0}})


@pytest.mark.parametrize(
    ("method", "bits", "optics", "says"),
    [
        ("dpac", 8, {}, "up to 7 dB more, through a pupil half as wide"),
        ("dpac", 1, {}, "up to 7 dB more"),
        ("joint", 1, {}, "1 to 2.5 dB less, through a pupil half as wide"),
        ("refine", 1, {}, "2 to 6 dB more through a pupil half as wide"),
        ("sgd", 1, {}, None),
        ("joint", 2, {}, None),
        ("joint", None, {}, None),
        ("dpac", 1, {"carrier": "auto"}, None),
        ("joint", 1, {"stop": engine.Stop("half")}, None),
        ("dpac", 1, {"lens": engine.Lens(0.1)}, None),  # the picture is where a stop would be
    ],
)
def test_on_axis_or_off(method, bits, optics, says):
    hologram = engine.Hologram(16, 16, 8e-6, optics=engine.Optics(**optics))
    decision = engine.axis_decision(method, bits, hologram)
    assert decision is None if says is None else decision.value == "on axis" and says in decision.reason


TAKEN = """
import json, threading, time
from benchmarks.scenes import Scenes
from benchmarks.stability.displays import camera
from holopath_addon import engine
from holopath_addon.engine.scene import variants
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

variants.activate()

def resident():
    return next(int(line.split()[1]) << 10 for line in open("/proc/self/status") if line.startswith("VmRSS"))

def watch():
    while not done:
        found.append(resident())
        time.sleep(0.01)

scenes, hologram = Scenes(), engine.Hologram(256, 256, 8e-6, depth_far=1e-3, depth_near=6e-3)
scene, view, settings = scenes.two_planes(scenes.emissive), camera(), engine.Settings(frames=1)
plan = engine.plan(scene, view, hologram, settings)
before, found, done = resident(), [], []
watching = threading.Thread(target=watch)
watching.start()
field = engine.render(scene, view, hologram, settings, plan)
pipeline.encode(field, Encoding("auto"), lambda done, message: None, scene, settings)
done.append(True)
watching.join()
print(json.dumps([max(found) - before, plan.phases_memory["refine"]]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads what Linux tells of a process")
def test_refine_takes_the_estimated_memory():
    """One frame in three colors needs memory mostly for the light that is found again."""
    program = [sys.executable, "-c", TAKEN]
    run = subprocess.run(program, capture_output=True, text=True, timeout=600, check=True)
    taken, estimate = json.loads(run.stdout.splitlines()[-1])
    assert 0.4 * estimate < taken < 1.1 * estimate + 150e6  # for compiled kernels
