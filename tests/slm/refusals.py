"""What refusals look like."""

import re
from contextlib import contextmanager

import pytest

from holopath_addon import engine


@contextmanager
def refused(says):
    """Refused in one sentence."""
    with pytest.raises(engine.InvalidInput, match=says) as caught:
        yield
    text = str(caught.value)
    assert text.endswith(".") and "\n" not in text and not re.search(r"[.!?] [A-Z]", text), text
