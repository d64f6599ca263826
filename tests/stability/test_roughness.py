"""Low roughness: no step of sharpness or brightness where a δ lobe becomes a narrow one."""

import pytest

from benchmarks.stability.roughness import SWEEPS
from benchmarks.stability.sweep import faults, walk

QUICK = [sweep for sweep in SWEEPS if sweep.quick]


@pytest.mark.parametrize("sweep", QUICK, ids=[sweep.name for sweep in QUICK])
def test_no_step_across_the_switch(backend, sweep):
    assert faults(sweep, walk(sweep, sweep.quick)) == []
