"""A file comes in as its writer means it, or it is refused with a remedy."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from holopath_addon import engine
from tests.exchange import foreign

PRECISION = 2e-6  # of float32, radians and relative to amplitudes of a few units


def look(data, processes):
    """Read what somebody means; whether it was read, and else the sentence."""
    with tempfile.TemporaryDirectory() as folder:
        meant = data.draw(foreign.meant(Path(folder), processes))
        try:
            found = meant.read()
        except engine.InvalidInput as error:
            assert "\n" not in str(error) and ("--" in str(error) or "write" in str(error).lower())
            return str(error)
    truth, story = meant.truth, meant.story
    kind, shape = type(found), found.data.shape
    assert kind is (engine.WaveField if np.iscomplexobj(truth) else engine.PhaseHologram), story
    assert shape == truth.shape, story
    if np.iscomplexobj(truth):
        wrong = np.abs(found.data - truth).max() / 4
    else:
        assert found.data.min() >= 0 and found.data.max() < np.float32(2 * np.pi)
        wrong = np.abs(np.exp(1j * found.data.astype(float)) - np.exp(1j * truth)).max()
    assert wrong < PRECISION, f"{story}: {wrong:.3g}"
    return None


def run(count, processes):
    view = []

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate,),
        report_multiple_bugs=False,
    )
    @given(st.data())
    def each(data):
        view.append(look(data, processes))

    each()
    return view


def test_what_is_meant_comes_in_or_is_refused():
    view = run(80, False)
    assert 20 < view.count(None) < 70


@pytest.mark.slow
def test_what_2000_people_mean():
    view = run(2000, True)
    assert 600 < view.count(None) < 1700
