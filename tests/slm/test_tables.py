"""Responses in files of text: what can be read in two ways is refused."""

import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from holopath_addon import engine
from holopath_addon.slm.tables import read_response
from tests.slm.refusals import refused

TURN = 2 * math.pi
RISING = np.linspace(0, 1.1 * TURN, 16) ** 1.1


def written(tmp_path, text, name="response.txt"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


@pytest.mark.parametrize(
    ("line", "apart", "decimal"),
    [
        ("{phase}", "\n", "."),
        ("{phase}", " ", "."),
        ("{level} {phase}", "\n", "."),
        ("{level}\t{phase}", "\n", "."),
        ("{level},{phase}", "\n", "."),
        ("{level}; {phase}", "\n", "."),
        ("{level};{phase}", "\r\n", ","),
        ("{level}\t{phase}", "\n", ","),
    ],
)
def test_lists_and_tables(line, apart, decimal, tmp_path):
    """One phase a level, or level and phase, as spreadsheets and makers write them; of any language."""
    lines = [
        line.format(level=level, phase=f"{phase:.9f}".replace(".", decimal))
        for level, phase in enumerate(RISING)
    ]
    for header in ("", "Gray level, phase\n", "# measured on Monday\n\n"):
        path = written(tmp_path, header + apart.join(lines))
        np.testing.assert_allclose(read_response(path), RISING, atol=1e-8)


@pytest.mark.parametrize(
    ("unit", "scale"),
    [
        ("(rad)", 1),
        ("[mrad]", 1e-3),
        ("(deg)", math.pi / 180),
        ("in turns", TURN),
        ("(2 pi)", TURN),
        ("[π]", math.pi),
    ],
)
def test_units_that_a_header_names(unit, scale, tmp_path):
    lines = "\n".join(f"{level};{phase / scale}" for level, phase in enumerate(RISING))
    np.testing.assert_allclose(
        read_response(written(tmp_path, f"level;phase {unit}\n{lines}")), RISING, rtol=1e-9
    )


def test_some_levels_of_all(tmp_path):
    """Lines are drawn between those that were measured."""
    path = written(tmp_path, "0 0\n64 1.5\n128 3.0\n255 6.5\n")
    shown = read_response(path)
    assert len(shown) == 256 and shown[32] == pytest.approx(0.75) and shown[255] == 6.5


def test_a_binary_device(tmp_path):
    np.testing.assert_allclose(read_response(written(tmp_path, "0 3.1415926")), (0, math.pi), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (" ".join(map(str, RISING / TURN)), "turns, or units of pi"),
        (" ".join(map(str, RISING / math.pi)), "turns, or units of pi"),
        ("phase (rad) or (pi)\n0 1 2 3 4 5 6", "several units"),
        ("\n".join(f"{n} {16 * n}" for n in range(256)), "the voltage of each level"),
        ("\n".join(f"{n} {n / 40} 0" for n in range(256)), "3 columns"),
        ("\n".join(f"{n} {n / 40}" for n in range(1, 257)), "does not count levels from 0"),
        ("0 0\n64 3\n200 6.5", "levels up to 200"),
        ("0 0\n1 nought", "among its numbers"),
        ("phase\n", "no phases"),
        ("7", "no phases"),
        ("0 nan 5", "no phases"),
        ("0 100.5 200.5", "exceeds 20 turns"),
        ("0 112.5", "reaches 112.5, which may be radians or degrees"),
        ("0,012\n0,049\n6,1", "does not count levels from 0"),
        ("0 " * 200000, "more than 65536"),
    ],
)
def test_what_cannot_be_meant_or_in_two_ways(text, says, tmp_path):
    with refused(says):
        read_response(written(tmp_path, text))


def test_a_makers_table_of_voltages(tmp_path):
    with refused("even steps of a turn"):
        read_response(written(tmp_path, "\n".join(f"{n} {n / 4}" for n in range(256)), "slm6411.lut"))


@hypothesis.settings(max_examples=150, deadline=None, derandomize=True, database=None)
@hypothesis.given(
    st.integers(1, 6),
    st.floats(0.3, 3),
    st.sampled_from([None, ("rad", 1.0), ("pi", math.pi), ("turns", TURN), ("deg", math.pi / 180)]),
    st.sampled_from([1.0, math.pi, TURN, math.pi / 180]),
    st.sampled_from(["{1}", "{0} {1}", "{0},{1}", "{0};{1}"]),
    st.booleans(),
)
def test_exact_or_refused(tmp_path_factory, bits, turns, named, scale, line, falling):
    """A table of any unit gives the intended phases, or a refusal."""
    meant = np.linspace(0, turns * TURN, 2**bits) * (-1 if falling else 1)
    scale = named[1] if named else scale
    lines = [line.format(level, repr(float(phase))) for level, phase in enumerate(meant / scale)]
    text = "\n".join(([f"level, phase ({named[0]})"] if named else []) + lines)
    path = written(tmp_path_factory.mktemp("response"), text)
    try:
        found = read_response(path)
    except engine.InvalidInput as error:
        assert not named, error
        return
    hypothesis.assume(named or scale in (1.0, math.pi / 180) or turns * TURN / scale < 4)
    np.testing.assert_allclose(found, meant, rtol=1e-9, atol=1e-9)
