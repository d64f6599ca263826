"""Other libraries as propagators: the same picture, depths and phases, so the same light within the recordable band."""

import pytest

from benchmarks.chart import peers
from benchmarks.chart.scenes import built
from holopath_addon import engine
from holopath_addon.engine.waves.propagation import propagate


@pytest.mark.oracle
@pytest.mark.parametrize("name", peers.PEERS)
def test_a_peer_shows_what_our_layers_show(backend, name):
    if peers.missing(name):
        pytest.skip(peers.missing(name))
    hologram = engine.Hologram(64, 64, 8e-6, (516.5e-9,), 0.5e-3, 1.5e-3)
    scene, camera = built("planes", 64)
    settings = engine.Settings(method="rgbd", frames=2, quality="preview", spp=4)
    ours = engine.render(scene, camera, hologram, settings)
    theirs = peers.render(name, scene, camera, hologram, settings)
    pictures, others = (engine.reconstruct(field, (0.5, 1.0, 2.0)) for field in (ours, theirs))
    # they keep what is beyond the band between layers, which occlusion then mixes in
    for picture, other in zip(pictures, others, strict=True):
        assert engine.psnr(other, picture, 8) > 30
        assert other.mean() == pytest.approx(picture.mean(), rel=0.03)


@pytest.mark.parametrize("frames", [1, 6])
def test_a_library_as_ours_shows_the_same(backend, monkeypatch, frames):
    """However random the phases of layers are: by our own propagation in place of a library's."""
    monkeypatch.setattr(peers, "_torchoptics", lambda waves, *how: propagate(waves, *how[:3]))
    hologram = engine.Hologram(64, 64, 8e-6, (516.5e-9,), 0.5e-3, 1.5e-3)
    scene, camera = built("planes", 64)
    settings = engine.Settings(method="rgbd", frames=frames, spp=1)
    ours = engine.render(scene, camera, hologram, settings)
    theirs = peers.render("rgbd-torchoptics", scene, camera, hologram, settings)
    pictures, others = (engine.reconstruct(field, (0.5, 1.0, 2.0)) for field in (ours, theirs))
    for picture, other in zip(pictures, others, strict=True):
        assert engine.psnr(other, picture, 8) > 30


def test_a_library_that_is_not_there_is_told(monkeypatch):
    monkeypatch.setattr(peers.importlib.util, "find_spec", lambda name: None)
    assert peers.missing("rgbd-odak") == "rgbd-odak is skipped: odak is not installed."


def test_progress_may_cancel(backend):
    hologram = engine.Hologram(32, 32, 8e-6, (516.5e-9,), 0.5e-3, 1.0e-3)
    scene, camera = built("planes", 32)

    def stop(done, message):
        raise engine.Cancelled("enough")

    with pytest.raises(engine.Cancelled):
        peers.render(
            "rgbd-torchoptics", scene, camera, hologram, engine.Settings(method="rgbd", spp=1), None, stop
        )
