"""Distances as text."""

import math

import pytest

from holopath_addon import engine
from holopath_addon.workflow import lengths


@pytest.mark.parametrize(
    ("text", "meters"),
    [
        ("0.5m", 0.5),
        ("50cm", 0.5),
        ("500 mm", 0.5),
        ("2D", 0.5),
        ("0D", math.inf),
        ("inf", math.inf),
        ("3", 3.0),
    ],
)
def test_distances(text, meters):
    assert lengths.parse_distance(text) == pytest.approx(meters)


@pytest.mark.parametrize("text", ["-1m", "0", "-2D", "nan", "1 parsec", "", "1m2"])
def test_invalid_distances(text):
    with pytest.raises(engine.InvalidInput):
        lengths.parse_distance(text)
