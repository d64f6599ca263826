"""The truth to compare with: Mitsuba's thin-lens camera with the hologram's pupil, one a wavelength."""

import math

import numpy as np

from . import backend
from .hologram import channel
from .mapping import DepthMapping
from .probing import near_end


def reference(scene, camera, hologram, focus, pupil=None, spp=256, near=None, max_depth=8, progress=None):
    """Incoherent pictures through a thin lens, the limit of a perfect hologram of infinitely many frames.

    A cone of slope s_max fills a pupil of radius s_max beta / F; a picture focused at depth D is that of a
    thin lens of this radius focused at D. Without lens shift and with the whole pupil Mitsuba's own
    `thinlens` sensor is used; otherwise its path tracer on rays from the part of the pupil asked for.

    Parameters
    ----------
    scene, camera, hologram :
        As for `render`.
    focus : sequence of float
        World depths, metres; `math.inf` allowed.
    pupil : Pupil, optional
    spp : int
        Paths a pixel.
    near : float, optional
        World depth of the volume's near end; found as in `plan` when not given.
    max_depth : int
        As `Settings.max_depth`.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, float32, shape (focus, y, x, wavelength)

    Raises
    ------
    InvalidInput, BackendUnavailable, Cancelled
    """
    backend.activate()
    from .dispersion import tuned

    progress = progress or (lambda done, message: None)
    near = near or near_end(scene, camera, hologram)
    mapping = DepthMapping.of(hologram, camera, near)
    mapping.depth_to_z(list(focus))  # refuses what is behind the camera
    images = np.empty((len(focus), hologram.height, hologram.width, len(hologram.wavelengths)), np.float32)
    centred = pupil is None and camera.shift_x == 0 and camera.shift_y == 0
    for f, depth in enumerate(focus):
        for k, wavelength in enumerate(hologram.wavelengths):
            radius = mapping.pupil_radius(hologram.max_slope(wavelength))
            depth = min(depth, 1e5)
            with tuned(scene, (wavelength,)):
                if centred:
                    picture = _thin_lens(scene, camera, hologram, radius, depth, spp, max_depth)
                else:
                    picture = _sheared_lens(
                        scene, camera, hologram, mapping, radius, pupil, depth, spp, max_depth
                    )
            images[f, :, :, k] = picture[:, :, channel(wavelength)]
            progress(
                (f * len(hologram.wavelengths) + k + 1) / (len(focus) * len(hologram.wavelengths)),
                "Reference",
            )
    return images


def _thin_lens(scene, camera, hologram, radius, depth, spp, max_depth):
    """Mitsuba's `thinlens` sensor; it looks along +z with x to the left, the camera along -z."""
    import mitsuba as mi

    flip = np.diag([-1.0, 1.0, -1.0, 1.0])
    sensor = mi.load_dict(
        {
            "type": "thinlens",
            "to_world": mi.ScalarTransform4f(camera.to_world @ flip),
            "fov": math.degrees(camera.fov_x),
            "fov_axis": "x",
            "aperture_radius": radius,
            "focus_distance": depth,
            "near_clip": max(camera.clip_start, 1e-4),
            "far_clip": min(camera.clip_end, 1e6),
            "film": {
                "type": "hdrfilm",
                "width": hologram.width,
                "height": hologram.height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "independent"},
        }
    )
    integrator = _integrator(scene, camera, max_depth)
    return np.asarray(mi.render(scene, sensor=sensor, integrator=integrator, spp=spp))


def _sheared_lens(scene, camera, hologram, mapping, radius, pupil, depth, spp, max_depth):
    """Rays from the pupil's points through the pixels of the focused plane."""
    import drjit as dr
    import mitsuba as mi

    integrator = _integrator(scene, camera, max_depth)
    pixels = hologram.width * hologram.height
    right, up, forward = (mi.Vector3f(*map(float, axis)) for axis in camera.axes)
    index = dr.arange(mi.UInt32, pixels)
    total = mi.Color3f(0)
    centre = (pupil.x, pupil.y) if pupil else (0.0, 0.0)
    size = pupil.diameter / 2 if pupil else radius
    weight = mi.Float(0)
    for s in range(spp):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(s, pixels)
        jitter = sampler.next_2d()
        x = (
            (mi.Float(index % hologram.width) + jitter.x - 0.5 * hologram.width)
            * hologram.pitch
            / mapping.focal
        )
        y = (
            (0.5 * hologram.height - mi.Float(index // hologram.width) - jitter.y)
            * hologram.pitch
            / mapping.focal
        )
        lens = size * mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()) + mi.Point2f(*centre)
        inside = dr.squared_norm(lens) <= radius**2
        tan_x = x + mapping.centre_x - lens.x / depth
        tan_y = y + mapping.centre_y - lens.y / depth
        direction = forward + tan_x * right + tan_y * up
        origin = (
            mi.Point3f(*map(float, camera.position))
            + lens.x * right
            + lens.y * up
            + camera.clip_start * direction
        )
        ray = mi.RayDifferential3f(origin, dr.normalize(direction))
        if math.isfinite(camera.clip_end):
            ray.maxt = (camera.clip_end - camera.clip_start) * dr.norm(direction)
        light, _, _ = integrator.sample(scene, sampler, ray, None, inside)
        total += dr.select(inside, light, 0)
        weight += dr.select(inside, mi.Float(1), 0)
        dr.eval(total, weight)
    mean = np.stack([np.asarray(c / weight) for c in total], axis=-1)
    return mean.reshape(hologram.height, hologram.width, 3)


def _integrator(scene, camera, max_depth):
    """Mitsuba's path tracer; with masks in view the volumetric one, as 3.9's `path` squares their opacity."""
    import mitsuba as mi

    from .lobes import SpecularLobes

    kind = "volpath" if SpecularLobes(scene).passes else "path"
    paths = mi.load_dict({"type": kind, "max_depth": max_depth, "rr_depth": max(5, max_depth)})
    if camera.sees_sky or scene.environment() is None:
        return paths

    class WithoutSky(mi.SamplingIntegrator):
        """The same less what comes straight from the environment."""

        def sample(self, scene, sampler, ray, medium=None, active=True):
            light, valid, extra = paths.sample(scene, sampler, ray, medium, active)
            return light - _sky_in_view(scene, ray, active), valid, extra

    return WithoutSky(mi.Properties())


def _sky_in_view(scene, ray, active):
    """Radiance of the environment that reaches rays through nothing, or through masks and clear panes."""
    import drjit as dr
    import mitsuba as mi

    def body(ray, share, active):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        share = dr.select(active, share * si.bsdf().eval_null_transmission(si, active), share)
        active &= dr.max(share) > 0
        return dr.select(active, si.spawn_ray(ray.d), ray), share, active

    state = (mi.Ray3f(ray), mi.Color3f(1), mi.Bool(active))
    ray, share, _ = dr.while_loop(state, lambda *s: s[-1], body, label="sky in view")
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    si.wi = -ray.d
    return dr.select(active, share * scene.environment().eval(si), 0)
