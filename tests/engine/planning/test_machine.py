"""Speed of a machine."""

import ctypes
import json
import math
import os
import sys
from dataclasses import asdict, astuple
from pathlib import Path

import numpy as np
import pytest

from holopath_addon.engine.planning import machine
from holopath_addon.engine.planning.machine import Slowness


def anew(folder):
    """Slowness as another process measures it."""
    forget()
    return machine.slowness(folder)


def forget():
    machine._slowness.cache_clear()
    machine._process_slowness.cache_clear()


@pytest.mark.slow
def test_the_machine_s_speed_is_kept(tmp_path, monkeypatch):
    found = anew(tmp_path)
    # a card runs programs in a hundredth; beside other work any number of times as slow is right
    *times, copies = astuple(found)
    assert all(1e-3 < each < math.inf for each in times) and 0 <= copies < math.inf
    with monkeypatch.context() as patched:
        patched.delattr(machine, "_measured")
        assert anew(tmp_path) == found
    for damaged in (
        "",
        "[]",
        '{"made_with": "another", "slowness": {"core": 1, "programs": 1, "transforms": 1}}',
        '{"slowness": 1}',
    ):
        (tmp_path / machine.FILE).write_text(damaged)
        assert anew(tmp_path) != Slowness(1, 1, 1)
    assert [file.name for file in tmp_path.iterdir()] == [machine.FILE]
    forget()


@pytest.mark.skipif(sys.platform != "linux", reason="by the library's name there")
def test_threads_are_profiled_only_while_work_is_timed(backend):
    """Profiled threads keep cores busy for longer after all later work. Also where the timed work fails."""
    import drjit as dr
    import mitsuba as mi

    pool = ctypes.CDLL(str(Path(dr.__file__).parent / "libnanothread.so"))
    profiled = []

    def work():
        profiled.append(pool.pool_profile())
        return dr.arange(mi.Float, 1000) + 1

    seconds, _, result = machine.timed(work)
    assert seconds > 0 and result[2] == 3
    with pytest.raises(ZeroDivisionError):
        machine.timed(lambda: 1 / (work() is None))
    assert profiled == [1, 1] and pool.pool_profile() == 0


def test_a_machine_that_was_busy_is_measured_again(tmp_path, monkeypatch):
    """The minimum of each figure counts, and later measurements wait until the kept ones are old."""
    file = tmp_path / machine.FILE
    for taken, age, expected in (
        ((5, 2, 9), 0, (5, 2, 9)),
        ((1, 3, 1), 1, (5, 2, 9)),
        ((1, 3, 1), machine.MAX_AGE_SECONDS, (1, 2, 1)),
    ):
        monkeypatch.setattr(machine, "_measured", lambda library, taken=taken: Slowness(*taken))
        if age:
            os.utime(file, (file.stat().st_mtime - age,) * 2)
        assert anew(tmp_path) == Slowness(*expected)
        assert json.loads(file.read_text())["slowness"] == asdict(Slowness(*expected))
    forget()


def test_a_library_s_own_transforms_and_copies_are_timed(backend, as_on_a_card, monkeypatch):
    """A library in a card's memory is timed with its copies; else nothing is copied, by the processor's transforms."""
    from holopath_addon.engine.waves import arrays, libraries

    for name, value in (("SIDE", 16), ("COPIED", 64), ("LANES", 16)):
        monkeypatch.setattr(machine, name, value)
    kinds, fft2 = [], arrays.fft2

    def spy(waves, **options):
        kinds.append(type(waves))
        return fft2(waves, **options)

    monkeypatch.setattr(arrays, "fft2", spy)
    name, _ = libraries.choose()
    assert machine._measured("numpy").copies == machine._measured(name).copies == 0
    as_on_a_card(1 << 30)
    assert machine._measured(name).copies > 0
    assert kinds[0] is np.ndarray and len(set(kinds)) == 2


def test_each_backend_has_its_own_figures(monkeypatch):
    """A process may change it within minutes, as Blender's preferences do."""
    forget()
    measured = iter(range(1, 9))
    monkeypatch.setattr(machine, "_measured", lambda library: Slowness(*[next(measured)] * 4))
    monkeypatch.setattr(machine, "timed", lambda work: (0.0, 0.0, None))
    found = []
    for variant in ("llvm_ad_rgb", "cuda_ad_rgb", "llvm_ad_rgb"):
        monkeypatch.setattr(machine.variants, "activate", lambda variant=variant: variant)
        found.append(machine.slowness(None, "numpy"))
    assert found[0] == found[2] != found[1]
    forget()
