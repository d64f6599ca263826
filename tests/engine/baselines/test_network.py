"""A user's own network: what it is given, what it may return, and how faults are told."""

import numpy as np
import pytest

from benchmarks.scenes import FOV, GREEN, Scenes
from holopath_addon import engine
from holopath_addon.engine.baselines import network
from holopath_addon.engine.waves.propagation import propagate

SIDE, FRAMES = 64, 2
NETWORK = '''
import numpy as np
from holopath_addon import engine
from holopath_addon.engine.waves.propagation import propagate

calls = []

def flat(rgb, z, hologram, frame):
    """Everything on one layer."""
    calls.append((rgb.copy(), z.copy(), hologram, frame))
    rng = np.random.default_rng(frame)
    noise = np.exp(2j * np.pi * rng.random(z.shape))
    waves = [np.sqrt(4 / np.pi * rgb[..., k]) * noise for k in range(rgb.shape[-1])]
    rgb[:] = z[:] = np.nan  # these are the function's own
    depth = calls[-1][1].mean()
    return np.stack([propagate(w, hologram.pitch, l, -depth) for w, l in zip(waves, hologram.wavelengths)])

def real(rgb, z, hologram, frame):
    return np.moveaxis(rgb, -1, 0)

def listed(rgb, z, hologram, frame):
    return [0]

def turned(rgb, z, hologram, frame):
    return rgb.astype(np.complex64)

def endless(rgb, z, hologram, frame):
    return np.moveaxis(rgb / 0, -1, 0).astype(np.complex64)

def failing(rgb, z, hologram, frame):
    raise KeyError("weights\\nof the second layer")

def stopped(rgb, z, hologram, frame):
    raise engine.Cancelled

number = 3
'''


@pytest.fixture
def show(backend, tmp_path, monkeypatch):
    """A render by a function of the file above, or by whatever HOLOPATH_NETWORK is set to."""
    (tmp_path / "own_network.py").write_text(NETWORK)
    (tmp_path / "broken.py").write_text("import a_module_that_is_not_there")
    monkeypatch.syspath_prepend(tmp_path)
    scenes = Scenes()
    scene = scenes.scene(wall=scenes.plane(1.0, scenes.emissive(scenes.gray(0.5))))
    hologram = engine.Hologram(SIDE, SIDE, 8e-6, (GREEN, 640e-9), 0.2e-3, 0.4e-3, near=0.5)

    def render(name):
        monkeypatch.setenv("HOLOPATH_NETWORK", name.format(folder=tmp_path))
        settings = engine.Settings(method="network", frames=FRAMES, max_depth=1, spp=2)
        return engine.render(scene, engine.Camera(np.eye(4), FOV), hologram, settings)

    return render


@pytest.mark.parametrize("name", ["own_network:flat", "{folder}/own_network.py:flat"])
def test_given_a_picture_with_depth_and_kept_as_returned(show, name):
    field = show(name)
    assert field.data.dtype == np.complex64 and field.data.shape == (FRAMES, 2, SIDE, SIDE)
    z = float(field.mapping.depth_to_z(1.0))
    for m in range(FRAMES):
        noise = np.exp(2j * np.pi * np.random.default_rng(m).random((SIDE, SIDE)))
        expected = propagate(np.sqrt(4 / np.pi * 0.5) * noise, 8e-6, GREEN, -z)
        # z comes in single precision, which turns the whole wave by hundredths of a radian
        overlap = abs(np.vdot(expected, field.data[m, 0])) / np.linalg.norm(expected) ** 2
        assert overlap == pytest.approx(1, abs=1e-3)
    middle = engine.reconstruct(field, [1.0])[0, 8:-8, 8:-8]
    assert middle.mean() == pytest.approx(0.5, rel=0.05)


def test_what_a_network_sees(show):
    import own_network

    own_network.calls.clear()
    field = show("own_network:flat")
    assert [call[3] for call in own_network.calls] == list(range(FRAMES))
    for rgb, z, hologram, _ in own_network.calls:
        assert rgb.dtype == z.dtype == np.float32 and hologram == field.hologram
        np.testing.assert_allclose(rgb, np.full((SIDE, SIDE, 2), 0.5), rtol=1e-5)
        np.testing.assert_allclose(z, np.full((SIDE, SIDE), field.mapping.depth_to_z(1.0)), rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "Set the environment variable HOLOPATH_NETWORK to"),
        ("own_network", "Expected HOLOPATH_NETWORK as 'package.module:function'"),
        ("own_network:", "Expected HOLOPATH_NETWORK as 'package.module:function'"),
        ("no_such_module:flat", "'no_such_module', which cannot be loaded .*No module"),
        ("{folder}/none.py:flat", "none.py', which cannot be loaded .*No such file"),
        ("broken:flat", "'broken', which cannot be loaded .*a_module_that_is_not_there"),
        ("own_network:none", "has no function 'none'"),
        ("own_network:number", "has no function 'number'"),
        ("own_network:real", "a NumPy array of complex64 .* in frame 0, got an array of float32"),
        ("own_network:listed", "a NumPy array of complex64 .* in frame 0, got list"),
        ("own_network:turned", r"the shape \(wavelength, y, x\) = \(2, 64, 64\) .*, got \(64, 64, 2\)"),
        ("own_network:endless", "Expected finite numbers .* in frame 0, got NaN or infinity"),
        ("own_network:failing", r"failed in frame 0 .*weights.*second layer.*\. Fix the function"),
    ],
)
def test_faults_in_one_line(show, name, message):
    with np.errstate(divide="ignore"), pytest.raises(engine.InvalidInput, match=message) as caught:
        show(name)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


def test_cancelled_in_a_network(show):
    with pytest.raises(engine.Cancelled):
        show("own_network:stopped")


def test_results_depend_on_the_function_s_file(tmp_path, monkeypatch):
    """The file's digest is among the inputs of a render; a name without a file has none."""
    path = tmp_path / "mine.py"
    path.write_text("def flat(): pass")
    monkeypatch.setenv("HOLOPATH_NETWORK", f"{path}:flat")
    first = network.digests()
    path.write_text("def flat(): return 1")
    assert len(first) == 1 and first.keys() == network.digests().keys() and first != network.digests()
    monkeypatch.setenv("HOLOPATH_NETWORK", "json:loads")
    assert list(network.digests()) == ["network json:loads"]
    for name in ("", "no.such.module:f", f"{tmp_path / 'none.py'}:f", "sys:f"):
        monkeypatch.setenv("HOLOPATH_NETWORK", name)
        assert network.digests() == {}
