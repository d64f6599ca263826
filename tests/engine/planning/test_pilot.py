"""The pilot's rays and paths."""

import numpy as np

from holopath_addon import engine


def test_packets_are_chosen_by_the_scene(build, camera):
    """Measured speeds do not choose packets, as fields would then differ now and then."""
    display = engine.Hologram(64, 64, 8e-6, (516.5e-9,), 1e-3, 1.5e-3)
    for cells, coherent in ((4, True), (400, False)):
        x, y = np.meshgrid(np.linspace(-0.3, 0.3, cells + 1), np.linspace(-0.3, 0.3, cells + 1))
        wall = build.mesh(np.stack([x, y, -1 - 0 * x], axis=-1), {"bsdf": {"type": "diffuse"}})
        scene = build.scene(wall=wall, sky={"type": "constant"})
        plans = [engine.plan(scene, camera, display).to_dict() for _ in range(2)]
        for plan in plans:
            assert plan["coherent"] is coherent
            for name in ("stages", "phases", "seconds", "decisions"):  # as measured
                del plan[name]
        assert plans[0] == plans[1]


def test_compiling_counts_where_the_pilot_compiled(build, camera, small, monkeypatch):
    """A first render's programs are the pilot's and some more."""
    from holopath_addon.engine.planning import pilot

    timed, radiance = pilot._timed, []
    for extra in (0.0, 1e3):  # far above what a busy machine adds by itself

        def slower(*work, extra=extra):
            seconds, _, result = timed(*work)
            return seconds, extra, result

        monkeypatch.setattr(pilot, "_timed", slower)
        radiance.append(engine.plan(build.two_planes(build.diffuse), camera, small).stages["radiance"])
    assert radiance[0] + 1e3 < radiance[1] < radiance[0] + 2e3
