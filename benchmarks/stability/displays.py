"""Edges of the display and of the effort: pitch, wavelength, distance, size, frames, rays, encoding, texels, memory."""

import math
import multiprocessing
import re
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.scenes import FOV, GREEN, Scenes
from holopath_addon import engine
from holopath_addon.engine.encoding import descent
from holopath_addon.engine.scene import variants
from holopath_addon.engine.waves import propagation
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

from .sweep import LIMITS, Sweep

SIDE, PITCH, FRAMES = 128, 8e-6, 8
FOCUS = (0.5, 1.0, 2.0)  # meters: on the near plane, between the two, on the far one
SPP = 64  # of references
QUIET_SPP = 512  # where pictures become good, or all light is indirect
MOST_DB = 60.0  # an error of 1e-3: what is under it counts as none


@cache
def build():
    """Builders of scenes, in an active backend."""
    variants.activate()
    return Scenes()


@cache
def planes():
    """Two emissive planes in one gray, so that all wavelengths have the same picture."""
    make = build()

    def gray(texture):
        shades = np.array(texture["bitmap"]).mean(-1, keepdims=True)
        return make.emissive({**texture, "bitmap": make.mi.Bitmap(np.repeat(shades, 3, -1))})

    return make.two_planes(gray)


@cache
def flat(radiance=0.5):
    """An even plane that fills the view, also an upright one, at 1 m."""
    return build().scene(plane=build().plane(1.0, build().emissive(build().gray(radiance)), 1.0))


def camera(fov=FOV):
    return engine.Camera(np.eye(4), fov)


def display(side=SIDE, pitch=PITCH, wavelength=GREEN, far=1e-3, near=6e-3, **options):
    """A hologram in one wavelength."""
    height, width = side if isinstance(side, tuple) else (side, side)
    return engine.Hologram(width, height, pitch, (wavelength,), far, near, **options)


def border(hologram, distance):
    """Pixels at each edge that lose light of a picture at a distance to the SLM's aperture."""
    slope = hologram.widest_slope
    return math.ceil(slope * abs(distance) / hologram.pitch) + 1


def compared(scene, hologram, settings, focus=FOCUS, edge=None, spp=SPP, fov=FOV):
    """Figures of a render against Mitsuba's thin lens, means over focus depths; and the plan's warnings.

    `edge` pixels around, that lose light to the aperture, are left out.
    """
    view = camera(fov)
    plan = engine.plan(scene, view, hologram, settings)
    field = engine.render(scene, view, hologram, settings, plan)
    pictures = engine.reconstruct(field, focus)
    truth = engine.reference(scene, view, hologram, focus, spp=spp, near=field.near)
    edge = border(hologram, hologram.depth_near) if edge is None else edge
    inner = slice(edge, -edge or None)
    psnr = [engine.psnr(p, t, edge) for p, t in zip(pictures, truth, strict=True)]
    ratio = [p[inner, inner].mean() / t[inner, inner].mean() for p, t in zip(pictures, truth, strict=True)]
    figures = {
        "psnr": float(np.mean(psnr)),
        "brightness": float(np.mean(ratio)),
        "rays": plan.rays_per_pixel,
    }
    return figures | said(plan)


def said(plan):
    """What a plan warns of, as a figure."""
    return {"warned": " ".join(plan.warnings)} if plan.warnings else {}


SETTINGS = engine.Settings(frames=FRAMES, method="full")


# Pixel pitch


def pitch(micrometres):
    """The volume goes with the depth of focus, pitch squared over wavelength: the same picture from any display."""
    scale = (micrometres * 1e-6 / PITCH) ** 2
    hologram = display(pitch=micrometres * 1e-6, far=1e-3 * scale, near=6e-3 * scale)
    return compared(planes(), hologram, SETTINGS)


def pitch_alone(micrometres):
    """The volume stays: finer pixels show more depth, and need more rays for it."""
    return _alone(display(256, micrometres * 1e-6, far=0.5e-3, near=3e-3), 101)


def _alone(hologram, edge):
    """Figures of the same inner part; where too little light is left of it, only what the plan says."""
    plan = engine.plan(planes(), camera(), hologram, SETTINGS)
    if hologram.captured_share(max(plan.z_low, plan.z_high, key=abs)) < MIN_CAPTURED:
        return {"rays": plan.rays_per_pixel} | said(plan)
    figures = compared(planes(), hologram, SETTINGS, edge=edge)
    if hologram.max_slope(hologram.wavelengths[0]) * plan.planes[0].depth_limit < 0.5 * hologram.pitch:
        figures["psnr of one depth"] = figures.pop(
            "psnr"
        )  # a surface's light falls into one pixel of the plane
    return figures


# Wavelength


def wavelength(nanometres):
    """The volume goes with the depth of focus."""
    scale = GREEN / (nanometres * 1e-9)
    hologram = display(wavelength=nanometres * 1e-9, far=1e-3 * scale, near=6e-3 * scale)
    return compared(planes(), hologram, SETTINGS)


def wavelength_alone(nanometres):
    """The volume stays."""
    return _alone(display(wavelength=nanometres * 1e-9, far=0.5e-3, near=3e-3), 38)


# Distance of the volume from the SLM

WINDOW = 128  # pixels of the fields that are propagated alone
CRITICAL = WINDOW * PITCH * math.sqrt((2 * PITCH / GREEN) ** 2 - 1)  # of the window, padded to twice its size


@cache
def speckle(side=WINDOW):
    """Noise of nearly all recordable frequencies in a smooth window."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((side, side)) + 1j * rng.standard_normal((side, side))
    f = np.fft.fftfreq(side)
    noise = np.fft.ifft2(np.fft.fft2(noise) * (f[:, None] ** 2 + f**2 < 0.4**2))
    window = np.hanning(side)
    return (noise * window[:, None] * window).astype(np.complex64)


def truth_of_propagation(field, distance):
    """torchoptics: the angular spectrum up to the critical distance, the Rayleigh-Sommerfeld integral beyond.

    Each samples its kernel without aliases on its own side.
    """
    import torch
    import torchoptics

    source = torchoptics.Field(torch.tensor(field, dtype=torch.complex128), GREEN, spacing=PITCH)
    if distance < CRITICAL:
        there = source.propagate_to_z(distance, propagation_method="ASM", asm_pad=(3 * WINDOW, 3 * WINDOW))
    else:
        there = source.propagate_to_z(distance, propagation_method="DIM")
    return there.data.numpy()


def propagated(distance):
    """Propagation alone, over millimeters."""
    field = speckle()
    ours = propagation.propagate(field, PITCH, GREEN, distance * 1e-3, band="full")
    truth = truth_of_propagation(field, distance * 1e-3)
    error = np.linalg.norm(ours - truth) / np.linalg.norm(truth)
    return {
        "psnr": min(MOST_DB, -20 * math.log10(error)),
        "brightness": float(np.linalg.norm(ours) / np.linalg.norm(truth)) ** 2,
        "error": float(error),
    }


def distance(millimeters):
    """The volume's far end at a distance from the SLM, which may lie in it or before it; the inner part."""
    far = millimeters * 1e-3
    return compared(planes(), display(far=far, near=far + 2.5e-3), SETTINGS, edge=55)


MIN_CAPTURED = 0.75  # of the light: below, pictures are not compared
EDGE = 32  # pixels: the aperture blurs the picture, whose surroundings it has no light of


def aperture(millimeters):
    """One plane in focus, all of the picture, against what the aperture lets through of the truth."""
    far = millimeters * 1e-3
    hologram = display(far=far, near=far + 1e-3, depth_mapping="fit")
    scene, view, settings = textured(), camera(), replace(SETTINGS, frames=24)
    plan = engine.plan(scene, view, hologram, settings)
    field = engine.render(scene, view, hologram, settings, plan)
    picture = engine.reconstruct(field, [1.0])[0]
    truth = engine.reference(scene, view, hologram, [1.0], spp=SPP, near=field.near)[0]
    z = float(field.mapping.depth_to_z(1.0))
    truth = truth * passed(hologram, z)[..., None]
    return {
        "psnr": engine.psnr(picture, truth, EDGE),
        "brightness": float(picture[EDGE:-EDGE, EDGE:-EDGE].mean() / truth[EDGE:-EDGE, EDGE:-EDGE].mean()),
        "captured": hologram.captured_share(z),
    } | said(plan)


@cache
def textured():
    """One plane at 1 m."""
    make = build()
    return make.scene(plane=make.plane(1.0, make.emissive(make.texture(64, 3, contrast=2))))


def passed(hologram, distance, samples=41):
    """Share of each picture point's cone that meets the SLM's aperture, by geometry."""
    axis = np.linspace(-1, 1, samples)
    disk = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    disk = disk[np.hypot(*disk.T) <= 1]
    walk = hologram.max_slope(hologram.wavelengths[0]) * distance / hologram.pitch * disk
    y, x = np.mgrid[: hologram.height, : hologram.width]
    share = np.zeros(x.shape)
    for over, up in walk:
        share += (abs(x + over - (hologram.width - 1) / 2) < hologram.width / 2) & (
            abs(y + up - (hologram.height - 1) / 2) < hologram.height / 2
        )
    return share / len(walk)


# Size

SIZES = ((17, 31), (64, 16), (31, 43), (61, 67), (128, 128), (257, 127), (251, 509), (640, 360), (769, 1021))
SIZES += ((1280, 720), (1920, 1080), (1920, 1200), (2560, 1600), (3840, 2160))
SIZE_OF = {width * height: (height, width) for width, height in SIZES}


def size(pixels):
    """An even plane, in focus and a little out of it."""
    hologram = display(SIZE_OF[pixels], far=0.05e-3, near=0.2e-3)
    field = engine.render(flat(), camera(), hologram, replace(SETTINGS, frames=2))
    edge = 4  # pixels: the cone's walk and the fringes at the aperture's edge
    pictures = engine.reconstruct(field, [1.0, 0.5])[:, edge:-edge, edge:-edge]
    return {
        "brightness": float(pictures[0].mean() / 0.5),
        "out of focus": float(pictures[1].mean() / 0.5),
        "contrast": float(pictures[0].std() / pictures[0].mean()),
    }


# Frames


@cache
def frames_truth():
    hologram = display(near=6e-3)
    return engine.reference(planes(), camera(), hologram, FOCUS, spp=QUIET_SPP, near=0.5)


def frames_random(frames):
    """An even plane out of focus: fully developed speckle, whose contrast is one over the root of the frames."""
    settings = replace(SETTINGS, frames=frames, phase_field="random")
    field = engine.render(flat(), camera(), display(256), settings)
    inner = engine.reconstruct(field, [0.7, 1.4])[:, 32:-32, 32:-32]
    contrast = np.mean([picture.std() / picture.mean() for picture in inner])
    return {"brightness": float(inner.mean() / 0.5), "speckle": float(contrast * math.sqrt(frames))}


def frames_designed(frames):
    """Two planes: the more frames, the nearer to the truth; on one recording plane for both."""
    settings = replace(SETTINGS, frames=frames, planes=1, phase_field="designed")
    field = engine.render(planes(), camera(), display(), settings)
    return _seen(field)


def frames_encoded(frames):
    """What phases of the two planes show by the default encoding, of a field by default."""
    settings = engine.Settings(frames=frames, planes=1)
    scene, view, hologram = planes(), camera(), display()
    plan = engine.plan(scene, view, hologram, settings)
    field = engine.render(scene, view, hologram, settings, plan)
    phases = pipeline.encode(field, Encoding("auto"), lambda done, message: None, scene, settings)
    return _seen(phases.field())


def smoothness(randomness):
    """The same with one frame of smooth phases, as random as given, and its double phase."""
    settings = engine.Settings(frames=1, planes=1, phase_field="smooth", randomness=randomness)
    field = engine.render(planes(), camera(), display(), settings)
    shown = _seen(engine.encode(field, "dpac").field())
    return _seen(field) | {f"{name} of phases": figure for name, figure in shown.items()}


def _seen(field):
    pictures, edge = engine.reconstruct(field, FOCUS), border(display(), 6e-3)
    psnr = [engine.psnr(p, t, edge) for p, t in zip(pictures, frames_truth(), strict=True)]
    inner = slice(edge, -edge)
    ratio = pictures[:, inner, inner].mean() / frames_truth()[:, inner, inner].mean()
    return {"psnr": float(np.mean(psnr)), "brightness": float(ratio)}


# Rays a pixel


def rays(spp):
    """The lattice, narrower than the depth range needs or whole."""
    figures = compared(planes(), display(), replace(SETTINGS, spp=spp, planes=1))
    if "fewer than" in str(figures.get("warned")):  # no such picture was promised
        figures |= {f"{name} of few": figures.pop(name) for name in LIMITS}
    return figures


def paper(spp):
    """The paper's estimator: the error of its field falls with the root of the rays.

    Rays are the first of twice as many, so that the fields' difference is the error of the mean of two halves.
    """
    from holopath_addon.engine.tracing import wave_tracer  # needs a variant

    hologram, view, scene = display(far=0.2e-3, near=2.7e-3), camera(), planes()
    settings = replace(SETTINGS, estimator="paper", phase_field="random")
    with mock.patch.object(wave_tracer, "CHUNK_RAYS", 1 << 40):  # of which the random numbers depend
        fields = [
            engine.render(scene, view, hologram, replace(settings, spp=count)) for count in (spp, 2 * spp)
        ]
    few, many = (engine.reconstruct(field, [1.0])[0] for field in fields)
    truth = engine.reference(scene, view, hologram, [1.0], spp=256, near=0.5)[0]
    edge = border(hologram, 2.7e-3)
    inner = slice(edge, -edge)
    bright = truth[inner, inner].mean()
    apart = replace(fields[0], data=fields[1].data - fields[0].data)
    noise = 2 * spp * engine.reconstruct(apart, [1.0])[0][inner, inner].mean() / bright
    figures = {"psnr": engine.psnr(many, truth, edge), "noise": float(math.sqrt(noise))}
    if spp >= 16:
        # noise adds its own energy, half as much with twice the rays, which with few hides the picture's
        clean = 2 * many[inner, inner].mean() - few[inner, inner].mean()
        figures["brightness"] = float(clean / bright)
    return figures


# Encoding


@cache
def encoded():
    """A field, its own pictures, and the reference's."""
    hologram, settings = display(far=0.5e-3, near=3e-3), replace(SETTINGS, frames=4, phase_field="designed")
    field = engine.render(planes(), camera(), hologram, settings)
    return field, engine.reconstruct(field, FOCUS)


def own(phase, scale=1.0):
    """A phase hologram's pictures against those of its field, which was `scale` times as strong."""
    _, pictures = encoded()
    shown, edge = engine.reconstruct(phase.field(), FOCUS) / np.float32(scale**2), 15
    psnr = [engine.psnr(a, b, edge) for a, b in zip(shown, pictures, strict=True)]
    inner = slice(edge, -edge)
    return float(np.mean(psnr)), float(shown[:, inner, inner].mean() / pictures[:, inner, inner].mean())


STEPS = 30  # of sgd


def rate(radians):
    """Longest step of Adam, from what does next to nothing to what forgets the start."""
    with mock.patch.object(descent, "RATE", radians):
        phase = engine.encode(encoded()[0], "sgd")
    psnr, brightness = own(phase)
    return {"psnr": psnr, "brightness": brightness, "steps": phase.report["stages"][0]["steps"]}


def target(exponent):
    """The same field, 10^exponent as strong, by all ways to phases."""
    field, scale = encoded()[0], 10.0**exponent
    scaled = replace(field, data=field.data * np.float32(scale))
    holograms = [engine.encode(scaled, method, max_steps=STEPS) for method in ("dpac", "sgd", "joint")]
    figures = np.array([own(phase, scale) for phase in holograms])
    figures_of = {"psnr": float(figures[:, 0].mean()), "brightness": float(figures[:, 1].mean())}
    for name, (psnr, brightness) in zip(("dpac", "sgd", "joint"), figures, strict=True):
        figures_of |= {name: float(psnr), f"{name} brightness": float(brightness)}
    return figures_of


def bits(count):
    """Light that stays when phases are rounded, over sinc(1 / levels); and what sgd makes of so few levels."""
    field = encoded()[0]
    free = engine.encode(field, "sgd", max_steps=STEPS)
    rounded = engine.Modulator(bits=count).light(free.data)
    kept = abs(np.vdot(rounded, np.exp(1j * free.data))) / free.data.size
    fitted = engine.encode(field, "sgd", max_steps=STEPS, bits=count)
    levels = fitted.data * (2**count / (2 * math.pi))
    psnr, brightness = own(fitted)
    return {
        "psnr": psnr,
        "brightness": brightness,
        "efficiency": float(kept / np.sinc(1 / 2**count)),
        "psnr when rounded": own(replace(free, data=engine.Modulator(bits=count).shown(free.data)))[0],
        "off levels": float(np.abs(levels - np.round(levels)).max()),
    }


# Radiance cache

DEPTH = 32  # vertices: light that meets traced surfaces is followed further than that in the cache


def texels(factor):
    """Texels of a closed box, over those of a pixel, by which light is baked: against the thin lens."""
    from holopath_addon.engine.light import camera_view  # needs a backend

    build()
    hologram, fov = display(64, far=0.2e-3, near=1.2e-3), math.radians(36)
    reach = camera_view.CameraView.reach

    def scaled(view, triangles):
        texel, sides = reach(view, triangles)
        return factor * texel, sides

    with mock.patch.object(camera_view.CameraView, "reach", scaled):
        settings = replace(SETTINGS, frames=24, method="fast", max_depth=DEPTH)
        # all that is in view has a share of the noise of light that goes from wall to wall: 2 % by one seed
        fields = [
            engine.render(box(), camera(fov), hologram, replace(settings, seed=seed)) for seed in range(2)
        ]
    looks, truth = [engine.reconstruct(field, (1.0, 2.0)) for field in fields], box_truth()
    bake, edge = fields[0].report["bake"], border(hologram, hologram.depth_near)
    inner = slice(edge, -edge)
    psnr = [engine.psnr(p, t, edge) for pictures in looks for p, t in zip(pictures, truth, strict=True)]
    return {
        "psnr of traced" if bake["traced"] else "psnr": float(np.mean(psnr)),
        # the program never uses such texels
        "brightness of coarse" if factor > 2 else "brightness": float(
            np.mean([pictures[:, inner, inner].mean() for pictures in looks]) / truth[:, inner, inner].mean()
        ),
        "texels": bake["texels"],
        "coarser": bake["coarser"],
        "traced": len(bake["traced"]),
    }


@cache
def box():
    return build().closed_box()


@cache
def box_truth():
    hologram = display(64, far=0.2e-3, near=1.2e-3)
    near = engine.plan(box(), camera(math.radians(36)), hologram, SETTINGS).near
    return engine.reference(
        box(), camera(math.radians(36)), hologram, (1.0, 2.0), spp=QUIET_SPP, near=near, max_depth=DEPTH
    )


# Memory


def memory(megapixels):
    """What the plan of 24 frames in three colors asks for; nothing is rendered."""
    side = round(math.sqrt(megapixels * 1e6))
    hologram = engine.Hologram(side, side, PITCH, far_wavelengths(), depth_far=1e-3, depth_near=6e-3)
    return _asked(hologram, replace(SETTINGS, frames=24))


def memory_distance(millimeters):
    """The grid on which 1920 x 1080 pixels reach a picture without wrap-around."""
    far = millimeters * 1e-3
    hologram = engine.Hologram(1920, 1080, PITCH, far_wavelengths(), depth_far=far, depth_near=far + 5e-3)
    return _asked(hologram, SETTINGS)


def far_wavelengths():
    return engine.Hologram(1, 1, PITCH).wavelengths


def _asked(hologram, settings):
    plan = engine.plan(flat(), camera(), hologram, settings)
    return {"gigabytes": plan.memory_bytes / 1e9} | said(plan)


def memory_used(pixels):
    """Peak of a render in a process of its own, over what the plan said."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        planned, peak = pool.submit(_peak, pixels).result()
    return {"used": peak / planned, "gigabytes": planned / 1e9}


def _peak(pixels):
    """Bytes planned for a render of so many pixels, and its peak beyond what an idle program has."""
    hologram = display(round(math.sqrt(pixels)))
    plan = engine.plan(planes(), camera(), hologram, SETTINGS)
    idle = _resident("VmRSS")
    engine.reconstruct(engine.render(planes(), camera(), hologram, SETTINGS, plan), FOCUS)
    return plan.memory_bytes, _resident("VmHWM") - idle


def _resident(name):
    """A figure of this process in bytes, from Linux."""
    status = Path("/proc/self/status").read_text()
    return int(re.findall(rf"{name}:\s*(\d+) kB", status)[0]) << 10


def _spread(first, last, count):
    """Values a constant factor apart, three digits each."""
    return tuple(float(f"{v:.3g}") for v in np.geomspace(first, last, count))


EVEN = {"brightness": LIMITS["brightness"]}

SWEEPS = [
    Sweep(
        "pitch",
        "Pixels from as fine as two wavelengths to coarse, with a volume that goes with the depth of focus",
        "µm",
        (1, 1.25, 1.6, 2, 2.5, 3, 3.74, 4.5, 5.4, 6.4, 8, 10, 12.5, 16, 20, 25, 30, 36),
        pitch,
        "Nowhere: the same picture at every pitch; slabs of the radiance map are a share of the depth of focus.",
        quick=(1, 36),
        log=True,
    ),
    Sweep(
        "pitch, volume kept",
        "The same volume, 2.5 mm, from a small part of the depth of focus to 160 times it",
        "µm",
        (
            36,
            32,
            28,
            25,
            23.5,
            22,
            21.5,
            21,
            20,
            19,
            18,
            17,
            16,
            14.5,
            13,
            12,
            11,
            10,
            9,
            8.5,
            8,
            7.5,
            7,
            6.5,
            6,
            5.6,
            5.2,
            4.9,
            4.6,
            4.3,
        )
        + (4, 3.95, 3.9, 3.85, 3.8, 3.6, 3.4, 3.2, 3, 2.5, 2, 1.5, 1),
        pitch_alone,
        "From 25 µm on all depths are one, in focus and without speckle, 6 dB better; below 3.9 µm speckle comes back "
        "beyond the reach of designed fields, which the plan tells; below 3 µm the plan warns that the aperture passes "
        "too little light.",
        quick=(2, 1),
        log=True,
    ),
    Sweep(
        "wavelength",
        "From violet to telecom infrared, across the borders of the scene's channels at 490 and 580 nm",
        "nm",
        (
            400,
            430,
            455,
            480,
            489,
            491,
            516,
            550,
            579,
            581,
            600,
            640,
            700,
            780,
            850,
            940,
            1064,
            1200,
            1310,
            1550,
        ),
        wavelength,
        "Nowhere.",
        quick=(400, 1550),
    ),
    Sweep(
        "wavelength, volume kept",
        "The same volume, with a cone from 1.4 to 5.6 degrees",
        "nm",
        (400, 455, 516, 580, 640, 700, 780, 850, 940, 1064, 1200, 1310, 1430, 1550),
        wavelength_alone,
        "Nowhere; longer waves show more depth.",
    ),
    Sweep(
        "propagation",
        f"Distances through the critical one of a window padded to twice its size, {CRITICAL * 1e3:.1f} mm",
        "mm",
        (
            0,
            0.001,
            0.01,
            0.1,
            1,
            2,
            5,
            10,
            15,
            20,
            25,
            28,
            30,
            31,
            31.5,
            31.7,
            31.8,
            32,
            33,
            35,
            40,
            50,
            60,
            80,
        )
        + (100, 150, 200, 300, 500),
        propagated,
        "Nowhere: the padding grows with the distance, so that the band limit never cuts recordable light.",
        quick=(0, 1, 31, 32, 100),
        log=True,
    ),
    Sweep(
        "distance",
        "A volume of 2.5 mm that starts behind the SLM, in it, and before it",
        "mm",
        (-6, -5, -4, -3, -2.5, -2, -1.25, -1, -0.5, 0, 0.1, 0.5, 1, 2, 3, 5, 7, 9, 11),
        distance,
        "Nowhere in the part of the picture whose light meets the aperture; the plan warns under 75 % of the light.",
        quick=(-1.25, 0),
    ),
    Sweep(
        "distance, whole picture",
        "A picture so far that most of its light misses the aperture, against what geometry lets through",
        "mm",
        (0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 50, 60, 70, 85),
        aperture,
        "From 10 mm the plan warns of the share that is lost; brightness follows it. The narrower cone blurs, and its "
        "speckle grows, so PSNR falls.",
        quick=(0, 40),
        limits=EVEN,
    ),
    Sweep(
        "size",
        "From 17 x 31 to 3840 x 2160 pixels, with odd and prime sides",
        "pixels",
        tuple(SIZE_OF),
        size,
        "Nowhere; of the smallest, fringes of the aperture's edge take 3 %.",
        quick=(17 * 31, 257 * 127),
        log=True,
        limits=EVEN | {"out of focus": LIMITS["brightness"]},
    ),
    Sweep(
        "frames, random fields",
        "From one frame to twice those of one kernel: speckle times the root of the frames",
        "frames",
        (1, 2, 3, 4, 6, 8, 12, 16, 24, 30, 31, 32, 33, 34, 40, 48, 56, 63, 64),
        frames_random,
        "Nowhere.",
        quick=(1, 32, 33),
        log=True,
        limits=EVEN | {"speckle": LIMITS["brightness"]},
    ),
    Sweep(
        "frames, designed fields",
        "Through the sizes of the sets, 1, 3, 8 and 24, and of one kernel, 32",
        "frames",
        (
            1,
            2,
            3,
            4,
            5,
            6,
            7,
            8,
            9,
            10,
            11,
            12,
            13,
            14,
            15,
            16,
            17,
            18,
            19,
            20,
            21,
            22,
            23,
            24,
            25,
            26,
            28,
            31,
            32,
        )
        + (33, 36, 40, 48, 56, 64),
        frames_designed,
        "More frames are nowhere worse by more than 0.3 dB: sets are put together.",
        quick=(8, 9, 33),
        log=True,
        limits={"psnr": 0.3, "brightness": LIMITS["brightness"]},
        rises=("psnr",),
    ),
    Sweep(
        "frames, phases",
        "From one frame to a set of 24, the default encoding of a field by default",
        "frames",
        (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16, 24),
        frames_encoded,
        "Nowhere by more than 1 dB from one number to the next. From three frames to eight the whole pupil loses 3 dB: "
        "phases gain light in all parts of it.",
        quick=(1, 3),
        log=True,
        limits={"psnr": 1.2, "brightness": LIMITS["brightness"]},
    ),
    Sweep(
        "randomness",
        "One frame from smooth phases to random ones",
        "of smooth fields",
        (0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1),
        smoothness,
        "Nowhere in brightness; speckle takes 13 dB, most of them up to a randomness of 0.3.",
        quick=(0, 0.5, 1),
        limits=EVEN,
    ),
    Sweep(
        "rays",
        "A lattice from one ray to as fine as the depth range needs, and beyond",
        "rays a pixel",
        (
            1,
            5,
            9,
            13,
            21,
            29,
            37,
            45,
            57,
            69,
            81,
            97,
            113,
            129,
            149,
            161,
            177,
            185,
            193,
            197,
            213,
            225,
            241,
            249,
            261,
            277,
        )
        + (300, 1000, 4096, 16384),
        rays,
        "Below 277 rays the plan warns that they are too few for the depth range: PSNR falls by 1.5 dB with half of "
        "them, by 4 dB with 5 to 69; more change nothing.",
        quick=(21, 277, 16384),
        log=True,
    ),
    Sweep(
        "rays, paper's estimator",
        "Random rays: the error of the field times the root of the rays",
        "rays a pixel",
        (4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384),
        paper,
        "Nowhere; under 16 rays noise outweighs the picture.",
        quick=(8, 64),
        log=True,
        limits=EVEN | {"noise": LIMITS["brightness"]},
    ),
    Sweep(
        "encoder's rate",
        "The longest step of sgd, a constant of the program, over three decades",
        "rad",
        _spread(0.00316, 4.22, 26),
        rate,
        "With longer steps than 5 rad phases forget where they come from (9 dB less), with shorter ones than 0.003 the "
        "descent ends too soon; the program's 0.2 lies in between and is no setting.",
        quick=(0.01, 0.2, 2.0),
        log=True,
    ),
    Sweep(
        "target's scale",
        "The amplitudes to be encoded over 24 orders of magnitude, by dpac, sgd and joint",
        "log10",
        tuple(range(-12, 13)),
        target,
        "Nowhere: fields are scaled to a root mean square of 1.",
        quick=(-6, 0, 6),
    ),
    Sweep(
        "bits",
        "From two phases to 65536",
        "bits",
        tuple(range(1, 17)),
        bits,
        "Nowhere: what rounding keeps is sinc(1 / levels); sgd with few bits is better than rounding.",
        quick=(1, 2, 8, 16),
        limits=LIMITS | {"efficiency": LIMITS["brightness"]},
        rises=("psnr",),
    ),
    Sweep(
        "texels",
        "Texels of the radiance cache from a sixteenth to sixteen times a pixel's, in a closed box",
        "pixels",
        (0.0625, 0.088, 0.125, 0.177, 0.25, 0.354, 0.5, 0.707, 1, 1.41, 2, 2.83, 4, 5.66, 8, 11.3, 16),
        texels,
        "Surfaces whose texels would have to be over twice as large as asked for, to bound memory, are traced instead, "
        "with the noise of paths; texels of over two pixels, which the program never uses, lose light: 6 % at 5.7, "
        "11 % at 8, 19 % at 16 pixels.",
        quick=(1,),
        log=True,
    ),
    Sweep(
        "memory",
        "Pixels of a display with 24 frames in three colors",
        "megapixels",
        (0.1, 0.5, 1, 2, 4, 8, 12, 16, 20, 24, 32, 40, 50, 60, 67, 70),
        memory,
        "What needs more than is free is warned of; what needs more than the machine has is refused, and so is any "
        "display of over 67 megapixels.",
        quick=(1, 60, 70),
        log=True,
        limits={},
    ),
    Sweep(
        "memory over distance",
        "The grid on which light reaches a picture far from the SLM without wrap-around",
        "mm",
        (1, 10, 50, 100, 200, 500, 1000, 1500, 2000, 3000, 5000, 10000),
        memory_distance,
        "Refused where the grid does not fit into the machine; long before, the plan warns that the light does not fit "
        "through the aperture.",
        quick=(1, 10000),
        log=True,
        limits={},
    ),
    Sweep(
        "memory in use",
        "What a render takes at most, over what its plan says",
        "pixels",
        (1 << 14, 1 << 16, 1 << 18, 1 << 20, 1 << 22),
        memory_used,
        "The plan is an upper bound.",
        quick=(1 << 14,),
        log=True,
        limits={},
    ),
]
