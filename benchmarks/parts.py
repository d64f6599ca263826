"""Parts of a benchmark: one that fails takes no other with it."""

import traceback
from typing import Any

from holopath_addon.engine import InvalidInput


class Incomplete(Exception):
    """What was measured of a benchmark that lacks something.

    Parameters
    ----------
    table : str
        What was measured.
    faults : sequence of str
        What is missing and why, a sentence each.
    """

    def __init__(self, table, faults):
        super().__init__("; ".join(faults))
        self.table, self.faults = table, list(faults)


def sentence_of(error):
    """An exception in a line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def attempt(faults, name, work, instead: Any = None) -> Any:
    """Result of ``work()``; where that fails, `instead`, and `name` with the reason is among the `faults`."""
    try:
        return work()
    except Incomplete as error:
        faults += [f"{name}: {fault}" for fault in error.faults]
        return error.table
    except InvalidInput as error:
        faults.append(f"{name}: {error}")
        return instead
    except Exception as error:
        traceback.print_exc()
        faults.append(f"{name}: {sentence_of(error)}")
        return instead


def joined(parts, between="\n"):
    """Text of all parts one after the other.

    Parameters
    ----------
    parts : dict of str to callable
        By name; each returns its text.
    between : str

    Raises
    ------
    Incomplete
        With the text of those that did not fail.
    """
    faults, texts = [], []
    try:
        for name, work in parts.items():
            texts.append(attempt(faults, name, work))
    except KeyboardInterrupt:
        print(_text(texts, between), flush=True)  # hours of work are not lost
        raise
    table = _text(texts, between)
    if faults:
        raise Incomplete(table, faults)
    return table


def _text(texts, between):
    return between.join(text for text in texts if text)


def drawn(table, draw):
    """A table whose chart is drawn by ``draw()``: the table is kept where that fails."""
    return joined({"table": lambda: table, "chart": draw})
