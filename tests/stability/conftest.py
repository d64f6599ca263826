"""Sweeps compute with one thread."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def alone(one_thread):
    """No test here has Mitsuba read or write an OpenEXR file."""
