"""slmsuite's SLMs: in a process of their own, so that its libraries do not meet Blender's; and where it is absent."""

import importlib.util
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import engine, slm
from holopath_addon.slm.drivers.slmsuite_device import SlmsuiteDriver
from holopath_addon.workflow import failures
from tests.patience import NEVER, SOON

ROOT = Path(__file__).parents[2]

# Writes what it finds as JSON into the file that is named.
SCRIPT = r"""
import json, math, sys, time, warnings
import numpy as np
from holopath_addon import engine, slm
from holopath_addon.workflow import failures

warnings.simplefilter("ignore")
found = {}


def hologram(levels, bits):
    levels = np.asarray(levels)
    grid = engine.Hologram(levels.shape[1], levels.shape[0], 8e-6, (516.5e-9,), depth_far=1e-3, depth_near=2e-3)
    data = (levels * (2 * math.pi / 2**bits)).astype(np.float32)[None, None]
    return engine.PhaseHologram(data, grid, engine.Camera(np.eye(4), 0.5), 0.5, "dpac", (1.0,))


def display(driver, picture):
    driver.show(0, picture)
    return np.array(driver.slm.display)


for bits, side in ((8, 16), (10, 32)):
    levels = np.arange(2**bits).reshape(side, side)
    calibration = slm.Calibration(bits=bits)
    sequence = slm.Sequence([hologram(levels, bits)], calibration)
    options = {"resolution": [side, side]} | ({"bitdepth": bits} if bits != 8 else {})
    driver = slm.SlmsuiteDriver("simulated", options)
    driver.open(None, None)
    info = driver.info
    shown = display(driver, sequence.picture(0))
    zero = display(driver, slm.Sequence([hologram(0 * levels, bits)], calibration).picture(0))
    phases = np.array(driver.slm.set_phase(np.zeros((side, side))))
    # a correction of slmsuite's own, which floats would get
    driver.slm.source["phase"] = np.full((side, side), 1.0)
    corrected = display(driver, sequence.picture(0))
    driver.close()
    found[bits] = {
        "info": [info.name, info.width, info.height, info.bits, info.rate, info.drops, info.channels],
        "shown": shown.tolist(), "type": str(shown.dtype), "zero": np.unique(zero).tolist(),
        "zero as phases": np.unique(phases).tolist(), "corrected": corrected.tolist(),
        "closed": driver.slm is None,
    }

# eight bits on one of ten, wider than high: the numbers stay
levels = np.arange(48).reshape(4, 12) * 5
driver = slm.SlmsuiteDriver("simulated.SimulatedSLM", {"resolution": [12, 4], "bitdepth": 10})
driver.open(None, None)
found["wide"] = display(driver, slm.Sequence([hologram(levels, 8)]).picture(0)).tolist()
driver.close()

driver = slm.SlmsuiteDriver("simulated", {"resolution": [12, 4]})
counts = slm.stream(slm.Sequence([hologram(levels, 8)]), driver, rate=100, loops=5)
found["streamed"] = [counts.shown + counts.dropped, driver.slm is None]

refusals = {
    "unknown": ("pluto", {}), "two dots": ("a.b.c", {}), "no module": ("nothing.SLM", {}),
    "no class": ("simulated.Nothing", {}), "no options": ("simulated", {}),
    "other options": ("simulated", {"resolution": [8, 8], "bits": 3}), "bad size": ("simulated", {"resolution": [8]}),
    "bad value": ("simulated", {"resolution": [8, 8], "wav_um": "red"}), "holoeye": ("holoeye", {}),
    "santec": ("santec", {}), "hamamatsu": ("hamamatsu", {}), "meadowlark": ("meadowlark", {}),
    "mirrored": ("mirrored", {"display_number": 1}),
}
for name, (device, options) in refusals.items():
    start = time.monotonic()
    try:
        slm.stream(slm.Sequence([hologram(levels, 8)]), slm.SlmsuiteDriver(device, options), patience=5)
        found[name] = ["nothing", "", 0]
    except Exception as error:
        found[name] = [type(error).__name__, failures.sentence(error), time.monotonic() - start]
with open(sys.argv[1], "w") as file:
    json.dump(found, file)
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Results of the script."""
    if importlib.util.find_spec("slmsuite") is None:
        pytest.skip("slmsuite is not installed")
    path = tmp_path_factory.mktemp("slmsuite") / "found.json"
    words = [sys.executable, "-c", SCRIPT, path]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=NEVER, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(path.read_text())


@pytest.mark.oracle
@pytest.mark.parametrize(("bits", "side"), [(8, 16), (10, 32)])
def test_levels_are_shown_as_they_are(found, bits, side):
    """All of them, also where slmsuite has a correction of its own."""
    view = found[str(bits)]
    levels = np.arange(2**bits).reshape(side, side)
    np.testing.assert_array_equal(view["shown"], levels)
    np.testing.assert_array_equal(view["corrected"], levels)
    assert view["type"] == ("uint8" if bits == 8 else "uint16") and view["closed"]
    name, *rest = view["info"]
    assert "SimulatedSLM" in name and rest == [side, side, bits, None, True, 1]


@pytest.mark.oracle
@pytest.mark.parametrize("bits", [8, 10])
def test_phase_zero_is_level_zero(found, bits):
    """slmsuite itself would make it the highest: this is what is avoided."""
    assert found[str(bits)]["zero"] == [0]
    assert found[str(bits)]["zero as phases"] != [0]


@pytest.mark.oracle
def test_width_and_height(found):
    np.testing.assert_array_equal(found["wide"], np.arange(48).reshape(4, 12) * 5)


@pytest.mark.oracle
def test_streamed(found):
    assert found["streamed"] == [5, True]


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("unknown", "Expected a device of slmsuite \\(holoeye, .*simulated\\), got 'pluto'"),
        ("two dots", "Expected a device of slmsuite .*got 'a.b.c'"),
        ("no module", "nothing.SLM cannot be loaded"),
        ("no class", "simulated.Nothing cannot be loaded"),
        ("no options", "takes other options.*resolution"),
        ("other options", "takes other options.*bits"),
        ("bad size", "takes other options"),
        ("bad value", "red"),
        ("holoeye", "holoeye.Holoeye.*HEDS not installed"),
        ("santec", "santec.Santec.*DLLs not installed"),
        ("hamamatsu", "hamamatsu.Hamamatsu"),
        ("meadowlark", "meadowlark.Meadowlark"),
        ("mirrored", "pyglet not installed"),
    ],
)
def test_refusals(found, name, says):
    """Errors come at once, with a remedy; a missing library is not blamed on cables."""
    kind, text, seconds = found[name]
    if name in ("unknown", "two dots", "no module", "no class", "no options", "other options", "bad size"):
        assert kind == "InvalidInput", text
    assert re.search(says, text) and "\n" not in text and text.endswith("."), text
    assert "bug in HoloPath" not in text and seconds < SOON
    assert kind in ("InvalidInput", "DeviceLost")
    if "not installed" not in says or "DLL" in says:
        return  # what these classes raise does not tell a missing library from a missing device
    assert kind == "InvalidInput" and "cable" not in text, text


# Absent


@pytest.fixture
def absent(monkeypatch):
    """The driver reports slmsuite as missing if it is not installed."""
    find = importlib.util.find_spec

    def without(name, *words):
        return None if name.split(".")[0] == "slmsuite" else find(name, *words)

    monkeypatch.setattr(importlib.util, "find_spec", without)


def test_described_as_missing(absent):
    rows = {row["name"]: row for row in slm.describe()}
    assert set(rows) == {"display", "serial", "slmsuite", "files", "virtual"} == set(slm.DRIVERS)
    assert not rows["slmsuite"]["available"] and "pip install slmsuite" in rows["slmsuite"]["detail"]
    assert all(rows[name]["available"] for name in ("serial", "files", "virtual"))


@pytest.mark.oracle
def test_described_as_available():
    if importlib.util.find_spec("slmsuite") is None:
        pytest.skip("slmsuite is not installed")
    row = next(row for row in slm.describe() if row["name"] == "slmsuite")
    assert row["available"] and "pip" not in row["detail"] and "holoeye" in row["detail"]


@pytest.mark.parametrize("device", ["simulated", "holoeye", "nothing"])
def test_refused_where_it_is_absent(absent, device):
    with pytest.raises(engine.InvalidInput, match="`pip install slmsuite`") as caught:
        SlmsuiteDriver(device)
    assert failures.sentence(caught.value) == str(caught.value)


def test_others_work_where_it_is_absent(absent, tmp_path):
    grid = engine.Hologram(8, 6, 8e-6, (516.5e-9,), depth_far=1e-3, depth_near=2e-3)
    data = np.full((2, 1, 6, 8), math.pi, np.float32)
    hologram = engine.PhaseHologram(data, grid, engine.Camera(np.eye(4), 0.5), 0.5, "dpac", (1.0,))
    sequence = slm.Sequence([hologram])
    bench = slm.VirtualDriver(hologram)
    for driver in (slm.FilesDriver(tmp_path / "out"), bench):
        assert slm.stream(sequence, driver).shown == 2
    assert bench.capture().shape == (6, 8, 1)
    slm.SerialDriver("nowhere")
    slm.DisplayDriver()


def test_importing_holopath_does_not_import_it():
    """Nor its libraries: that would be slow, and could meet Blender's."""
    code = "import sys; from holopath_addon import slm; slm.describe(); print(*sys.modules, sep='\\n')"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    names = {name.split(".")[0] for name in done.stdout.split()}
    assert "holopath_addon" in names, done.stderr
    assert not names & {"slmsuite", "cv2", "matplotlib", "h5py", "pyglet", "sdl2", "serial"}
