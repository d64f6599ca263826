"""The form of refusals: one line, "What is wrong. What to do."."""

import re
from contextlib import contextmanager

import pytest

from holopath_addon import engine


@contextmanager
def refused(message):
    """Assert that the block is refused in a line of at most two sentences that matches a pattern."""
    with pytest.raises(engine.InvalidInput, match=message) as caught:
        yield
    text = str(caught.value)
    assert text.endswith(".") and "\n" not in text and len(re.findall(r"[.!?] [A-Z]", text)) < 2, text
