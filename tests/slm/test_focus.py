"""Focus planes, their file, and the motor that a controller on a serial port moves."""

import json
import math
import re
import time
from types import SimpleNamespace

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

pytest.importorskip("termios", reason="There are ptys on Unix alone.")

from holopath_addon import cli, engine
from holopath_addon.slm import Controller, DeviceLost, FocusPlanes, Plane, sweep
from holopath_addon.slm.drivers import controller as controller_module
from tests.patience import SOON
from tests.slm.device import Board, Firmware
from tests.slm.refusals import refused

FORMAT = {"format": "HoloPath focus planes", "format_version": 1}
FRAMES, TRIGGERS, FOCUS = 1, 2, 4

quick = settings(max_examples=40, database=None)


def some(*positions):
    """Planes at 80 mm, 81 mm and so on, with these positions."""
    return FocusPlanes(tuple(Plane(80e-3 + n * 1e-3, position) for n, position in enumerate(positions)))


# Planes


def test_default():
    """The default planes are those of the paper's prototype."""
    planes = FocusPlanes.spread().planes
    assert [plane.distance for plane in planes] == [0.08, 0.08125, 0.0825, 0.08375, 0.085]
    assert all(plane.position is None for plane in planes)


def test_spread():
    assert [plane.distance for plane in FocusPlanes.spread(1e-3, 2e-3, 3).planes] == [1e-3, 1.5e-3, 2e-3]
    assert [plane.distance for plane in FocusPlanes.spread(1e-3, 1e-3, 1).planes] == [1e-3]
    for words in ((1e-3, 2e-3, 0), (2e-3, 1e-3, 3), (1e-3, 1e-3, 2)):
        with refused("nearer to a farther"):
            FocusPlanes.spread(*words)


def test_in_order_of_distance():
    planes = FocusPlanes((Plane(3.0, 1), Plane(1.0, 2), Plane(2.0, 3)))
    assert [plane.distance for plane in planes.planes] == [1, 2, 3]
    assert [planes.position(n) for n in range(3)] == [2, 3, 1]


@pytest.mark.parametrize("distances", [(), (1, 1), (1, math.nan), (math.inf,)])
def test_planes_that_are_none(distances):
    with refused("one or more focus planes, each at a different"):
        FocusPlanes(tuple(Plane(distance) for distance in distances))


def test_calibrated():
    """One of them; the others, and what there was before, stay."""
    before = some(None, 7, None)
    after = before.with_position(2, -40)
    assert [plane.position for plane in after.planes] == [None, 7, -40]
    assert [plane.position for plane in before.planes] == [None, 7, None]
    assert after.with_position(2, 5).position(2) == 5 and after.position(1) == 7
    for number in (-1, 3):
        with refused(f"from 0 to 2, got {number}"):
            before.with_position(number, 1)
        with refused(f"got {number}"):
            before.position(number)
    with refused(r"Focus plane 0 \(80 mm\) has no motor position yet"):
        after.position(0)


@pytest.mark.parametrize(
    ("positions", "millimeters", "expected"),
    [
        ((100, 200, 400), 80, 100),
        ((100, 200, 400), 80.25, 125),
        ((100, 200, 400), 81.5, 300),
        ((100, 200, 400), 82, 400),
        ((100, None, 400), 81, 250),  # the planes that are known
        ((None, 200, 400), 81.75, 350),
        ((400, 200, -100), 81.25, 125),  # a motor that runs the other way
        ((0, 3, 9), 80.5, 2),  # to whole steps
        ((None, 5, None), 81, 5),
    ],
)
def test_between_planes(positions, millimeters, expected):
    assert some(*positions).position_at(millimeters * 1e-3) == expected


@pytest.mark.parametrize(
    ("positions", "millimeters", "says"),
    [
        ((1, 2, 3), 79.99, r"within the calibrated planes \(80 to 82 mm\), got 79.99 mm"),
        ((1, 2, 3), 82.01, "within"),
        ((None, 2, 3), 80.5, "81 to 82 mm"),
        ((1, 2, None), 81.5, "80 to 81 mm"),
        ((None, None, None), 81, "none is calibrated"),
        ((1, 2, 3), math.nan, "within"),
        ((1, 2, 3), math.inf, "within"),
    ],
)
def test_not_beyond_what_is_calibrated(positions, millimeters, says):
    with refused(says):
        some(*positions).position_at(millimeters * 1e-3)


# The file


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("focus")


def test_round_trip(folder):
    """Files keep distances to a nanometer, and the default planes exactly."""
    FocusPlanes.spread().with_position(1, 12).save(folder / "planes.json")
    assert FocusPlanes.load(folder / "planes.json") == FocusPlanes.spread().with_position(1, 12)

    positions = st.none() | st.integers(-(2**31), 2**31 - 1)

    @quick
    @given(st.dictionaries(st.integers(1, 10**9), positions, min_size=1, max_size=9))
    def check(rows):
        planes = FocusPlanes(tuple(Plane(n * 1e-9, position) for n, position in rows.items()))
        planes.save(folder / "planes.json")
        found = FocusPlanes.load(folder / "planes.json")
        assert [(round(p.distance * 1e9), p.position) for p in found.planes] == sorted(rows.items())
        for a, b in zip(found.planes, planes.planes, strict=True):
            assert a.distance == pytest.approx(b.distance, rel=1e-9)

    check()
    assert [path.name for path in folder.iterdir()] == ["planes.json"]


def test_readable(folder):
    """A user writes it by hand: millimeters, and positions or none."""
    (folder / "hand.json").write_text(
        json.dumps(FORMAT | {"planes": [{"distance_mm": 85}, {"distance_mm": 80, "position": 3}]})
    )
    found = FocusPlanes.load(folder / "hand.json").planes
    assert [(plane.distance, plane.position) for plane in found] == [(0.08, 3), (0.085, None)]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (FORMAT | {"format": "another", "planes": []}, "another format"),
        (FORMAT | {"format_version": 2, "planes": []}, "newer"),
        (FORMAT, "planes"),
        (FORMAT | {"planes": []}, "one or more"),
        (FORMAT | {"planes": [{"distance_mm": 1}, {"distance_mm": 1.0}]}, "different finite distance"),
        (FORMAT | {"planes": [{"position": 1}]}, "distance_mm"),
        (FORMAT | {"planes": [{"distance_mm": "near"}]}, "cannot be read"),
        (FORMAT | {"planes": [{"distance_mm": math.nan}]}, "different finite distance"),
        (FORMAT | {"planes": [80, 85]}, "cannot be read"),
        (FORMAT | {"planes": 5}, "cannot be read"),
    ],
)
def test_files_that_are_refused(data, says, tmp_path):
    (tmp_path / "planes.json").write_text(json.dumps(data))
    with refused(says):
        FocusPlanes.load(tmp_path / "planes.json")
    with pytest.raises(engine.InvalidInput, match="The focus planes .*planes.json"):
        FocusPlanes.load(tmp_path / "planes.json")


@pytest.mark.parametrize(
    "content", [b"", b"no", b"\xff\xfe{", b"null", b"5", b'"x"', b"[]", b"{}", b"[" * 99999]
)
def test_foreign_files(content, tmp_path):
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(engine.InvalidInput, match="x.json cannot be read"):
        FocusPlanes.load(tmp_path / "x.json")
    with refused("cannot be read"):
        FocusPlanes.load(tmp_path / "missing.json")


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
near_rows = st.fixed_dictionaries(
    {"distance_mm": st.just(80) | json_values}, optional={"position": json_values}
)
near_files = st.fixed_dictionaries({"planes": json_values | st.lists(near_rows | json_values, max_size=3)})


def test_any_json_is_read_or_refused(folder):
    @settings(quick, max_examples=200)
    @given(json_values | near_files.map(lambda data: FORMAT | data))
    @example(FORMAT | {"planes": [{"distance_mm": 80, "position": math.inf}]})
    @example(FORMAT | {"planes": [{"distance_mm": 10**400}]})
    @example(FORMAT | {"planes": "ab"})
    def check(data):
        (folder / "any.json").write_text(json.dumps(data), encoding="utf-8")
        try:
            planes = FocusPlanes.load(folder / "any.json")
        except engine.InvalidInput as error:
            assert "any.json" in str(error)
        else:
            assert all(isinstance(plane.position, int | None) for plane in planes.planes)

    check()


# Looking at every plane


def test_sweep():
    """Moves, then takes a picture, at each in its turn."""
    done, reports = [], []
    sweep(
        some(5, None, 7),
        lambda number: done.append(("move", number)),
        lambda number: done.append(("capture", number)),
        lambda share, message: reports.append((share, message)),
    )
    assert done == [(what, number) for number in range(3) for what in ("move", "capture")]
    assert [share for share, _ in reports] == pytest.approx([0, 1 / 3, 2 / 3]) and "81 mm" in reports[1][1]


def test_sweep_stopped():
    done = []

    def stop(share, message):
        if share > 0.5:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        sweep(some(1, 2, 3), done.append, done.append, stop)
    assert done == [0, 0, 1, 1]
    with pytest.raises(ValueError, match="blocked"):
        sweep(some(1, 2), lambda number: (_ for _ in ()).throw(ValueError("blocked")), done.append)
    assert done == [0, 0, 1, 1]


# The motor


class Motor(Firmware):
    """Notes when each motion ends; stays where it is when another program opens the port."""

    def __init__(self, speed=None, **options):
        super().__init__(**options)
        self.speed, self.arrivals = speed, []

    def restart(self):
        motor = [getattr(self, name, 0) for name in ("position", "target", "arrival")]
        super().restart()
        self.position, self.target, self.arrival = motor

    def _do(self, kind, payload):
        super()._do(kind, payload)
        if kind == 5:
            self.arrivals.append(self.arrival)


@pytest.mark.parametrize("target", [300, -300])
def test_returns_when_the_motion_has_ended(target):
    """Not before, and not long after; meanwhile it says where it is."""
    firmware, view = Motor(speed=300), []
    with Board(firmware) as board:
        controller = Controller(board.path)
        controller.open()
        start = time.monotonic()
        controller.focus(target, view.append)
        end = time.monotonic()
        assert firmware.positions == [target] and controller.position() == target
        controller.close()
    assert end >= firmware.arrivals[0] >= start + 0.9
    assert end - firmware.arrivals[0] < SOON
    steps = [abs(position) for position in view]
    assert len(steps) > 1 and steps == sorted(steps) and 0 <= steps[0] < steps[-1] <= 300


def test_one_after_the_other():
    """Each begins where the last has ended; one that is there already takes no time."""
    firmware = Motor(speed=2000)
    with Board(firmware) as board:
        controller = Controller(board.path)
        controller.open()
        for target in (100, 40, 40, 140):
            controller.focus(target)
            assert time.monotonic() >= firmware.arrivals[-1] and controller.position() == target
        controller.close()
    assert firmware.positions == [100, 40, 40, 140]


def test_stopped_while_it_moves():
    def stop(position):
        raise engine.Cancelled

    with Board(Motor(speed=10)) as board:
        controller = Controller(board.path)
        controller.open()
        start = time.monotonic()
        with pytest.raises(engine.Cancelled):
            controller.focus(1000, stop)
        assert time.monotonic() - start < SOON  # of 100
        assert 0 <= controller.resting_position() < 100  # usable as before
        assert board.firmware.positions == [1000, controller.position()]  # the motor does not go on
        controller.close()


def test_a_motor_that_never_arrives(monkeypatch):
    monkeypatch.setattr(controller_module, "FOCUS_TIMEOUT", 0.05)
    with Board(Motor(speed=10)) as board:
        controller = Controller(board.path)
        with pytest.raises(DeviceLost, match="has not arrived"):
            controller.focus(1000)
        assert len(board.firmware.positions) == 2 and controller.resting_position() < 100
        controller.close()


def test_a_motor_that_is_lost_on_its_way(monkeypatch):
    """The first error is said, and nothing waits for the device to come back."""
    monkeypatch.setattr("holopath_addon.slm.drivers.link.PATIENCE", 0.3)

    def unplug(position):
        board.mute = True

    with Board(Motor(speed=10)) as board:
        controller = Controller(board.path)
        with pytest.raises(DeviceLost, match="has not answered"):
            controller.focus(1000, unplug)
        board.mute = False
        controller.position()
        assert board.firmware.positions == [1000]
        controller.close()


def test_no_position_is_stored_while_the_motor_moves(tmp_path, capfd):
    """By the command; Blender asks the same function."""
    motor = Motor(speed=10)
    motor.target, motor.arrival = 1000, time.monotonic() + 100
    with Board(motor) as board:
        status = command(board, "--focus-planes", tmp_path / "planes.json", "--store", 1)
    said_in_one_line(capfd, status, "The focus still moves, now at .*Wait until it has stopped")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("position", [2**31, -(2**31) - 1])
def test_positions_that_no_motor_has(position):
    with refused("32 bits"):
        Controller("nowhere").focus(position)


def test_a_device_without_a_motor():
    with Board(Firmware(can=FRAMES | TRIGGERS)) as board:
        controller = Controller(board.path)
        controller.open()
        with refused("'Test device' on .* takes no focus commands"):
            controller.focus(5)
        controller.close()
    assert board.firmware.positions == []


# The command


def said_in_one_line(capfd, status, says):
    """The command was refused so."""
    error = capfd.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("holopath: ")]
    assert status == 2 and len(lines) == 1 and "Traceback" not in error, error
    assert re.search(says, lines[0]), lines[0]


@pytest.fixture
def board():
    with Board(Motor(speed=5000)) as found:
        yield found


def command(board, *words):
    return cli.main(["focus", "--port", board.path, *map(str, words)])


def test_store(board, tmp_path, capfd):
    """The first time it makes the file, with five planes; then it fills them in."""
    file = tmp_path / "planes.json"
    assert command(board, "--position", 120) == 0
    assert command(board, "--focus-planes", file, "--store", 1) == 0
    assert "plane 1 (81.25 mm) is position 120" in capfd.readouterr().err
    planes = FocusPlanes.load(file)
    assert planes == FocusPlanes.spread().with_position(1, 120)
    assert (
        command(board, "--position", -30) == 0 and command(board, "--focus-planes", file, "--store", 3) == 0
    )
    assert FocusPlanes.load(file) == planes.with_position(3, -30)
    assert board.firmware.positions == [120, -30]  # to store does not move
    assert [path.name for path in tmp_path.iterdir()] == ["planes.json"]


@pytest.mark.parametrize(
    ("words", "target"),
    [
        (["--plane", "1"], 200),
        (["--distance", "80.5"], 150),
        (["--position", "-77"], -77),
        (["--position=12"], 12),
        (["--plane", "0", "--baud", "9600"], 100),
    ],
)
def test_moves(words, target, board, tmp_path, capfd):
    some(100, 200, None).save(tmp_path / "planes.json")
    assert command(board, "--focus-planes", tmp_path / "planes.json", *words) == 0
    assert board.firmware.positions == [target] and time.monotonic() >= board.firmware.arrivals[0]
    assert f"position {target}" in capfd.readouterr().err


def test_quiet(board, capfd):
    assert command(board, "--position", 5, "--quiet") == 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--plane", "2"], r"Focus plane 2 \(82 mm\) has no motor position yet"),
        (["--plane", "7"], "from 0 to 2, got 7"),
        (["--plane", "-1"], "got -1"),
        (["--distance", "90"], "within the calibrated planes"),
        (["--distance", "nan"], "within the calibrated planes"),
        (["--store", "3"], "got 3"),
        (["--position", "3000000000"], "32 bits"),
        (["--plane", "0", "--baud", "3"], "got 3"),
        (["--plane", "0", "--distance", "80"], "not allowed with"),
        ([], "required"),
    ],
)
def test_refused(words, says, board, tmp_path, capfd):
    file = tmp_path / "planes.json"
    some(100, 200, None).save(file)
    before = file.read_bytes()
    said_in_one_line(capfd, command(board, "--focus-planes", file, *words), says)
    assert board.firmware.positions == [] and file.read_bytes() == before


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--plane", "0"], "missing.json cannot be read"),
        (["--distance", "81"], "missing.json cannot be read"),
        (["--store", "5"], "got 5"),
    ],
)
def test_missing_file(words, says, board, tmp_path, capfd):
    said_in_one_line(capfd, command(board, "--focus-planes", tmp_path / "missing.json", *words), says)
    assert list(tmp_path.iterdir()) == [] and board.firmware.positions == []


def test_damaged_file(board, tmp_path, capfd):
    """Not even written over."""
    (tmp_path / "planes.json").write_text("{}")
    for words in (["--plane", "0"], ["--store", "0"]):
        said_in_one_line(
            capfd, command(board, "--focus-planes", tmp_path / "planes.json", *words), "cannot be read"
        )
    assert (tmp_path / "planes.json").read_text() == "{}"


def test_no_file_named(board, capfd):
    for words in (["--plane", "0"], ["--distance", "80"], ["--store", "0"]):
        said_in_one_line(capfd, command(board, *words), "Give their file with --focus-planes")


def test_missing_port(tmp_path, capfd, monkeypatch):
    planes = tmp_path / "planes.json"
    status = cli.main(
        ["focus", "--port", str(tmp_path / "none"), "--focus-planes", str(planes), "--store", "0"]
    )
    said_in_one_line(capfd, status, "none cannot be opened.*holopath devices")
    assert list(tmp_path.iterdir()) == []
    built_in, board, other = (
        SimpleNamespace(device=name, vid=vid) for name, vid in (("A", None), ("B", 1), ("C", 2))
    )
    for ports, says in (
        ([], "found 0 .none"),
        ([built_in, board, other], "found 3 .A, B, C"),
        ([built_in, board], "port B cannot be opened"),
    ):
        monkeypatch.setattr("serial.tools.list_ports.comports", lambda ports=ports: ports)
        said_in_one_line(capfd, cli.main(["focus", "--position", "1"]), says)


def test_a_device_that_takes_no_focus(tmp_path, capfd):
    with Board(Firmware(can=FRAMES)) as board:
        said_in_one_line(capfd, command(board, "--position", 5), "takes no focus commands")
