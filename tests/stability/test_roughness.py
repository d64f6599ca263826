"""Low roughness: no step of sharpness or brightness where a δ lobe becomes a narrow one.

One mirror every day; where images of rough mirrors, glass and coats lie, tests/engine/test_chains.py holds to formulas.
"""

import pytest

from benchmarks.stability import roughness
from benchmarks.stability.roughness import SWEEPS
from benchmarks.stability.sweep import faults, walk

QUICK = [sweep for sweep in SWEEPS if sweep.quick]


@pytest.mark.parametrize(
    "sweep",
    [
        pytest.param(s, id=s.name, marks=() if s.name == "rough mirror, image" else pytest.mark.slow)
        for s in QUICK
    ],
)
def test_no_step_across_the_switch(backend, sweep, monkeypatch):
    monkeypatch.setattr(roughness, "SIDE", 128)
    assert faults(sweep, walk(sweep, sweep.quick)) == []
