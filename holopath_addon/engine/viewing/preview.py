"""Progressive path-traced image of the scene by Mitsuba, through a pinhole or a thin lens."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput
from ..scene import variants

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..progress import Progress

CHUNK_PATHS = 1 << 18  # between two calls of progress; a fraction of a second on two cores
FARTHEST = 1e30  # meters; remains finite in single precision


class Preview:
    """Image of a camera's view with square pixels: the mean over all paths so far.

    Cameras, sizes and lenses are data of the compiled program, so that another view needs no compilation, see `look`.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    width, height : int
        Numbers of pixels.
    focus : float, optional
        World depth in focus, meters; `math.inf` is allowed and the default.
    aperture : float
        Radius of the lens, meters; 0 for a pinhole, through which everything is sharp.
    max_depth : int
        As `Settings.max_depth`.
    seed : int
        Seed of the random paths.
    center : (float, float)
        Center of the lens, meters to the right and up of the camera's axis.

    Attributes
    ----------
    spp : int
        Number of paths for each pixel so far.

    Raises
    ------
    InvalidInput
        If the image is empty or the focus is not in front of the camera.
    BackendUnavailable
        If Mitsuba cannot compute on this machine.

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> _ = engine.variants.activate()  # before Mitsuba is imported
    >>> import mitsuba as mi
    >>> wall = {"type": "rectangle", "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.5}}}
    >>> scene = mi.load_dict({"type": "scene", "wall": wall})
    >>> place = np.eye(4)
    >>> place[2, 3] = 1.0  # 1 m before the wall
    >>> preview = engine.Preview(scene, engine.Camera(place, 0.5), 4, 3)
    >>> float(preview.refine(4).mean())
    0.5
    """

    def __init__(
        self,
        scene: mi.Scene,
        camera: Camera,
        width: int,
        height: int,
        focus: float | None = None,
        aperture: float = 0.0,
        max_depth: int = 8,
        seed: int = 0,
        center: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        variants.activate_for(scene)
        self._scene, self._max_depth, self._seed = scene, max_depth, seed
        self._integrators = {}
        self.look(camera, width, height, focus, aperture, center)

    def look(
        self,
        camera: Camera,
        width: int,
        height: int,
        focus: float | None = None,
        aperture: float = 0.0,
        center: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Start another view of the scene; parameters and errors as of the class."""
        import drjit as dr
        import mitsuba as mi

        from ..scene.buffers import constant

        if width < 1 or height < 1:
            raise InvalidInput(f"Expected an image of at least 1 x 1 pixels, got {width} x {height}.")
        if focus is not None and not focus > 0:
            raise InvalidInput(
                f"Expected a focus distance of a positive number of meters, or inf, got {focus:g} m."
            )
        self._lens = CameraLens(camera, width, height, focus or math.inf)
        self._aperture, self._center = number(aperture), constant(mi.Point2f, center)
        if camera.sees_sky not in self._integrators:
            self._integrators[camera.sees_sky] = path_tracer(self._scene, camera.sees_sky, self._max_depth)
        self._integrator = self._integrators[camera.sees_sky]
        self._size, self._width = (height, width), dr.opaque(mi.UInt32, width)
        self._light = np.zeros((height * width, 3), np.float32)
        self._launches = 0
        self.spp = 0

    def refine(self, spp: int = 1, progress: Progress | None = None) -> np.ndarray:
        """Add paths to the image.

        Parameters
        ----------
        spp : int
            Number of paths to add for each pixel.
        progress : callable, optional
            ``progress(done, message)``, may raise `Cancelled`: the image is then unchanged.

        Returns
        -------
        numpy.ndarray, float32, shape (y, x, 3)
            Mean of all paths so far as linear RGB, row 0 is the top. A new array for each call.

        Raises
        ------
        Cancelled
            If `progress` raised it.
        """
        progress = progress or (lambda done, message: None)
        light = np.empty_like(self._light)
        at_once = max(1, CHUNK_PATHS // spp)
        for first in range(0, len(light), at_once):
            progress(first / len(light), "Preview")
            part = slice(first, min(first + at_once, len(light)))
            light[part] = self._trace(first, part.stop - first, spp)
        self._light += light
        self.spp += spp
        return (self._light / self.spp).reshape(*self._size, 3)

    def _trace(self, first, pixels, spp):
        """Sum over new paths for some pixels, shape (pixel, 3)."""
        import drjit as dr
        import mitsuba as mi

        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(dr.opaque(mi.UInt32, (self._seed * 9973 + self._launches) & 0xFFFFFFFF), pixels)
        self._launches += 1
        index = dr.arange(mi.UInt32, pixels) + dr.opaque(mi.UInt32, first)
        row = index // self._width
        corner = mi.Point2f(index - row * self._width, row)
        paths = dr.opaque(mi.UInt32, spp)

        def body(count, light, sampler):
            place, point = corner + sampler.next_2d(), sampler.next_2d()
            point = self._center + self._aperture * mi.warp.square_to_uniform_disk_concentric(point)
            radiance, _, _ = self._integrator.sample(self._scene, sampler, self._lens.ray(place, point))
            return count + 1, light + radiance, sampler

        state = (mi.UInt32(0), mi.Color3f(0), sampler)
        _, light, _ = dr.while_loop(state, lambda n, *_: n < paths, body, label="preview")
        dr.eval(light)
        return np.stack([np.asarray(c) for c in light], axis=-1)


class CameraLens:
    """Rays from points of a lens through the image in the plane in focus; parameters as of `Preview`."""

    def __init__(self, camera: Camera, width: int, height: int, focus: float) -> None:
        import mitsuba as mi

        from ..scene.buffers import constant

        size = 2 * math.tan(camera.fov_x / 2)  # of the image at unit depth
        self._pitch = number(size / width)
        self._left = number(size * (camera.shift_x - 0.5))
        self._top = number(size * (camera.shift_y + 0.5 * height / width))
        self._position = constant(mi.Point3f, camera.position)
        self._right, self._up, self._forward = (constant(mi.Vector3f, axis) for axis in camera.axes)
        self._start, self._end = number(camera.clip_start), number(min(camera.clip_end, FARTHEST))
        self._curvature = number(1 / focus)

    def ray(self, place: mi.Point2f, point: mi.Point2f) -> mi.RayDifferential3f:
        """Rays to places in the image.

        Parameters
        ----------
        place : mitsuba.Point2f
            Pixels from the image's upper left corner, to the right and down.
        point : mitsuba.Point2f
            Point of the lens, meters to the right and up from its center.
        """
        import drjit as dr
        import mitsuba as mi

        tan_x = self._left + place.x * self._pitch - point.x * self._curvature
        tan_y = self._top - place.y * self._pitch - point.y * self._curvature
        direction = self._forward + tan_x * self._right + tan_y * self._up
        origin = self._position + point.x * self._right + point.y * self._up + self._start * direction
        ray = mi.RayDifferential3f(origin, dr.normalize(direction))
        ray.maxt = (self._end - self._start) * dr.norm(direction)
        return ray


def number(value: float) -> mi.Float:
    """A number as data of a compiled program, which then runs with another value without compilation."""
    import drjit as dr
    import mitsuba as mi

    return dr.opaque(mi.Float, float(value))


def path_tracer(scene: mi.Scene, sees_sky: bool, max_depth: int) -> mi.SamplingIntegrator:
    """Mitsuba's path tracer; with masks in view the volumetric one, because 3.9's `path` squares their opacity.

    Parameters
    ----------
    scene : mitsuba.Scene
    sees_sky : bool
        As in `Camera`.
    max_depth : int
        As in `Settings`.

    Returns
    -------
    mitsuba.SamplingIntegrator
    """
    import drjit as dr
    import mitsuba as mi

    from ..scene.lobes import SpecularLobes

    kind = "volpath" if SpecularLobes(scene).transmits else "path"
    paths = mi.load_dict({"type": kind, "max_depth": max_depth, "rr_depth": max(5, max_depth)})
    hidden = not sees_sky and scene.environment() is not None

    class Paths(mi.SamplingIntegrator):
        """The same without light straight from a hidden environment, and with 0 for values that are not finite."""

        def sample(self, scene, sampler, ray, medium=None, active=True):
            light, valid, extra = paths.sample(scene, sampler, ray, medium, active)
            if hidden:
                light -= _sky_in_view(scene, ray, active)
            return dr.select(dr.isfinite(light), light, 0), valid, extra

    return Paths(mi.Properties())


def _sky_in_view(scene, ray, active):
    """Radiance of the environment that reaches rays straight, or through masks and clear panes."""
    import drjit as dr
    import mitsuba as mi

    def body(ray, weight, active):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        weight = dr.select(active, weight * si.bsdf().eval_null_transmission(si, active), weight)
        active &= dr.max(weight) > 0
        return dr.select(active, si.spawn_ray(ray.d), ray), weight, active

    state = (mi.Ray3f(ray), mi.Color3f(1), mi.Bool(active))
    ray, weight, _ = dr.while_loop(state, lambda *s: s[-1], body, label="sky in view")
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    si.wi = -ray.d
    return dr.select(active, weight * scene.environment().eval(si), 0)
