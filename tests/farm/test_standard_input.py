"""Reading of standard input by programs that are told over it when to end."""

import os
from types import SimpleNamespace

import pytest

from holopath_addon.farm import standard_input


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    yield reading, writing
    os.close(reading)


def test_lines_come_whole(pipe):
    reading, writing = pipe
    os.write(writing, b'{"words": 1}\n{"wo')
    lines = standard_input.lines(reading)
    assert next(lines) == b'{"words": 1}'
    os.write(writing, b'rds": 2}\n\nnot ended')
    assert next(lines) == b'{"words": 2}'
    os.close(writing)
    assert list(lines) == [b""]


def test_no_read_waits_for_a_pipe_of_windows(pipe, monkeypatch):
    """A waiting read holds up programs and libraries that start meanwhile; a pipe that nobody writes to has ended."""
    reading, writing = pipe
    looks = iter([0, 0, 5])

    def peek(handle, size):
        assert (handle, size) == (("handle", reading), 0)
        waiting = next(looks, None)
        if waiting is None:
            raise BrokenPipeError
        if waiting:
            os.write(writing, b"order\n")
        return waiting, 0

    monkeypatch.setattr(standard_input, "INTERVAL", 0.0)
    monkeypatch.setattr(standard_input, "_winapi", SimpleNamespace(PeekNamedPipe=peek))
    monkeypatch.setattr(
        standard_input, "msvcrt", SimpleNamespace(get_osfhandle=lambda number: ("handle", number))
    )
    assert list(standard_input.lines(reading)) == [b"order"]
    os.close(writing)
