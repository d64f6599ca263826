"""A render in parts: the same field to the last bit, whatever the parts and whoever makes them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.rendering.division import PREPARED, DividedRender

RGB = (640e-9, 516.5e-9, 455.4e-9)


def quiet(done, message):
    pass


def made(work, last, first=None):
    """Make the steps from the first one up to the last one, but those that are needless."""
    names = list(work.steps)
    for name in names[names.index(first) if first else 0 : names.index(last) + 1]:
        if not work.needless(work.folder, name, work.job):
            assert not work.done(work.folder, name, work.job)
            work.make(name, quiet)
            assert work.done(work.folder, name, work.job)


def divided(what, folder, count, alone=False):
    """The field that parts join to; `alone` has a process of its own make each, which knows nothing of the others."""
    work = DividedRender(*what, folder, count)
    for name in work.steps:
        made(DividedRender(*what, folder, count) if alone else work, name, name)
    return DividedRender(*what, folder, count).joined(quiet)


def agrees(what, folder, count, alone=False):
    """Whether the parts join to what one process renders."""
    whole = engine.render(*what)
    joined = divided(what, folder, count, alone)
    assert joined.data.any() and np.array_equal(joined.data, whole.data)
    timed = {
        name: joined.plan[name] for name in ("stages", "seconds", "decisions", "phases")
    }  # which name seconds, too
    assert joined.plan == whole.plan | timed
    return joined, whole


@pytest.fixture(autouse=True)
def chunks(monkeypatch):
    """Of few paths: pixels of small holograms come in several, too."""
    monkeypatch.setattr("holopath_addon.engine.tracing.grains.CHUNK_PATHS", 1 << 13)


@pytest.fixture
def coloured(small):
    return replace(small, wavelengths=RGB)


@pytest.fixture
def planes(build, camera, coloured):
    """Two planes on recording planes of their own, three wavelengths, four frames."""
    return (
        build.two_planes(build.diffuse),
        camera,
        coloured,
        engine.Settings(method="full", frames=4, planes=2),
    )


@pytest.mark.parametrize(
    "count", [pytest.param(2, marks=pytest.mark.slow), 5, pytest.param(16, marks=pytest.mark.slow)]
)
def test_parts_join_to_the_whole(planes, tmp_path, count):
    joined, whole = agrees(planes, tmp_path, count)
    assert len(joined.plan["planes"]) == 2
    assert joined.report["rays"] == whole.report["rays"]
    assert joined.report["radiance_passes"] == whole.report["radiance_passes"]
    assert joined.report["foretold"]["field_error"] == whole.report["foretold"]["field_error"]


@pytest.mark.slow
def test_no_packet_is_whole_at_the_edges(planes, tmp_path):
    """Sides that tiles do not fill: their last packets belong to one part only."""
    scene, camera, hologram, settings = planes
    settings = replace(settings, frames=1)
    joined, whole = agrees((scene, camera, replace(hologram, width=77, height=91), settings), tmp_path, 7)
    assert joined.report["rays"] == whole.report["rays"]


@pytest.mark.slow
def test_any_process_makes_any_part(planes, tmp_path):
    agrees(planes, tmp_path, 3, alone=True)


@pytest.mark.slow
def test_rays_divide_evenly(planes, tmp_path):
    work = DividedRender(*planes, tmp_path, 4)
    rays = []
    for name in work.steps:
        work.make(name, quiet)
        rays.append(
            json.loads((tmp_path / name / "report.json").read_text()).get("rays", {}).get("wave rays")
        )
    shares = [share for share in rays if share]
    assert len(shares) == 4 and max(shares) < 1.2 * min(shares)


@pytest.mark.parametrize(
    "settings",
    [
        {"estimator": "paper", "spp": 16},
        pytest.param({"despeckle": 2}, marks=pytest.mark.slow),
        pytest.param({"radiance": "ray", "paths": 1}, marks=pytest.mark.slow),
        pytest.param({"phase_field": "random"}, marks=pytest.mark.slow),
        pytest.param({"frames": 33}, marks=pytest.mark.slow),  # more than are traced together
        pytest.param({"method": "fast"}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_whatever_the_settings(build, camera, small, tmp_path, settings):
    settings = engine.Settings(**{"method": "full", "frames": 2, "quality": "preview", **settings})
    agrees((build.two_planes(build.diffuse), camera, small, settings), tmp_path, 3)


def test_methods_that_do_not_divide(planes, tmp_path):
    with pytest.raises(engine.InvalidInput, match="point does not divide"):
        DividedRender(*planes[:3], engine.Settings(method="point"), tmp_path, 2)


def test_another_scene_is_refused(build, planes, tmp_path):
    DividedRender(*planes, tmp_path, 2).make(PREPARED, quiet)
    other = build.two_planes(build.emissive)
    with pytest.raises(engine.InvalidInput, match="another scene"):
        DividedRender(other, *planes[1:], tmp_path, 2).make("asked-1-1-of-2", quiet)


@pytest.mark.slow
def test_parts_of_two_preparations_do_not_mix(planes, tmp_path):
    """A plan goes by what is measured: made again it may be another one, which parts of the first do not fit."""
    work, other = (DividedRender(*planes, tmp_path, 2) for _ in range(2))
    made(work, "traced-1-of-2")
    other.make(PREPARED, quiet)
    for name in ("asked-1-1-of-2", "told-1-of-2", "traced-1-of-2"):
        assert not work.done(tmp_path, name, "")
    assert work.done(tmp_path, PREPARED, "")
    with pytest.raises(engine.InvalidInput, match="give the same command again"):
        work.make("traced-2-of-2", quiet)
    made(work, "told-5-of-2", "asked-1-1-of-2")
    work.make("traced-2-of-2", quiet)
    with pytest.raises(engine.InvalidInput, match="give the same command again"):
        work.make("gathered-1-of-2-of-2", quiet)
    work.make("traced-1-of-2", quiet)
    made(work, list(work.steps)[-1], "gathered-1-of-2-of-2")
    assert np.array_equal(work.joined(quiet).data, engine.render(*planes).data)


def test_a_part_that_is_cancelled_leaves_nothing(planes, tmp_path):
    work = DividedRender(*planes, tmp_path, 2)

    def cancel(done, message):
        raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        work.make(PREPARED, cancel)
    assert not work.done(tmp_path, PREPARED, work.job) and not list(tmp_path.iterdir())


@pytest.mark.slow
def test_later_questions_divide_too(build, camera, coloured, tmp_path, monkeypatch):
    """Rays that see textures alone, more paths where the first were too few, and wavelengths with rays of their own."""
    noise = "holopath_addon.engine.planning.noise"
    monkeypatch.setattr(f"{noise}.passes_for", lambda settings, noise: 2)
    monkeypatch.setattr(f"{noise}.wanted_noise", lambda settings: 0.1)
    checks = np.random.default_rng(3).choice([0.02, 0.9], (256, 256, 1)) * np.ones(3)
    texture = {"type": "bitmap", "bitmap": build.mi.Bitmap(checks.astype(np.float32)), "raw": True}
    glass = {"type": "dispersive_dielectric", "int_ior": 1.62, "abbe": 20.0}
    scene = build.scene(
        wall=build.plane(1.2, build.diffuse(texture), 0.3),
        ball={"type": "sphere", "center": [0.2, 0.2, -0.7], "radius": 0.1, "bsdf": glass},
        lamp={"type": "sphere", "center": [-1, 1, -0.4], "radius": 0.5, **build.emissive(build.grey(1.0))},
    )
    settings = engine.Settings(method="full", frames=1, planes=1, fixed={"textures": 4})
    agrees((scene, camera, replace(coloured, width=64, height=64), settings), tmp_path, 2)
    told = [json.loads(file.read_text()) for file in sorted(tmp_path.glob("told-*/questions.json"))]
    assert len(told[0]) == 3
    kinds = [[question["kind"] for question in asked if question] for asked in zip(*told, strict=True)]
    assert ["light", "textures", "light"] in [each[:3] for each in kinds]
