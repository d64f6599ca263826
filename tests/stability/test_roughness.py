"""Low roughness: no step of sharpness or brightness where a δ lobe becomes a narrow one.

Where images of rough mirrors, glass and coats lie, tests/engine/scene/test_specular_chains.py holds
to formulas every day.
"""

import pytest

from benchmarks.stability import roughness
from benchmarks.stability.roughness import SWEEPS
from benchmarks.stability.sweep import faults, walk

QUICK = [sweep for sweep in SWEEPS if sweep.quick]


@pytest.mark.slow
@pytest.mark.parametrize("sweep", QUICK, ids=[sweep.name for sweep in QUICK])
def test_no_step_across_the_switch(backend, sweep, monkeypatch):
    monkeypatch.setattr(roughness, "SIDE", 128)
    assert faults(sweep, walk(sweep, sweep.quick)) == []
