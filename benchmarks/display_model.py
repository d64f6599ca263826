"""Displays that are off in everything: how near each parameter is found, and what pictures gain by it.

``python -m benchmarks display_model [SEED..]``: a row for each random mis-setting (default 1 to 20), minutes each.
``python -m benchmarks display_model tuned [SEED..]``: what a camera in the loop gains (default 1 to 3).
"""

import sys
import time
from dataclasses import replace
from unittest import mock

import numpy as np

from holopath_addon import engine, slm
from holopath_addon.engine.viewing import metrics
from holopath_addon.engine.waves.gaussian_points import THIRD
from holopath_addon.slm import calibrating, fitting
from holopath_addon.slm.fitting import Setup, parameters, vector

from .parts import joined

SIDE, PITCH, GREEN, FOCI, VIEW = 40, 8e-6, 520e-9, (2e-3, 4.5e-3, 7e-3), (0.95, 0.95)
MIDDLE = 4.5e-3  # where pictures are compared
AT = (2e-3, 3.2e-3, 4.5e-3, 6e-3)  # and those of a camera in the loop: two of its foci, and between them
FRAMES = 8


def run(*seeds, pixels=SIDE, captures=64, foci=3, stages=None, rounds=12):
    """Table of seeds; worst parameters in percent of their range, in brackets the standard deviation that noise leaves
    them; PSNR of pictures on the bench in dB.
    """
    if seeds[:1] == ("tuned",):
        return _tuned(seeds[1:] or range(1, 4), pixels, rounds)
    fitted = mock.patch.object(fitting, "STAGES", fitting.STAGES[:stages])
    # a fit that is cut short explains less than one that is worth something
    explained = mock.patch.object(calibrating, "MIN_EXPLAINED", 0.0 if stages else calibrating.MIN_EXPLAINED)
    head = f"seed  seconds  crosstalk  {'worst parameters':<76}  uncalibrated   fitted    known"
    rows = {
        f"seed {seed}": lambda seed=int(seed): _row(seed, pixels, captures, FOCI[:foci])
        for seed in seeds or range(1, 21)
    }
    with fitted, explained:
        return joined({"head": lambda: head} | rows)


def _row(seed, pixels, captures, foci):
    window = slm.PatternWindow(pixels, PITCH, GREEN)
    camera = round(1.4 * pixels)
    bench, truth = slm.perturbed_bench(slm.nominal_setup(window, foci, (camera, camera), VIEW), window, seed)
    begun = time.perf_counter()
    found = slm.calibrate(bench.capture_values, window, foci, VIEW, captures)
    seconds = time.perf_counter() - begun
    spans = np.array([row.high - row.low for row in found.parameters])
    left = 100 * np.abs(found.values - vector(truth)) / spans
    noise = 100 * found.deviations / spans
    worst = ", ".join(
        f"{found.parameters[n].name} {left[n]:.2f} ({noise[n]:.2f})" for n in np.argsort(-left)[:3]
    )
    field = _field(pixels)
    known = slm.calibration_of(_as_found(found, truth), window)
    calibrations = slm.Calibration(), slm.calibration_of(found, window), known
    decibels = " ".join(f"{_decibels(bench, field, each):8.2f}" for each in calibrations)
    row = f"{seed:4}  {seconds:7.0f}  {truth.model.crosstalk:9.2f}  {worst:<76}  {decibels}"
    print(row, file=sys.stderr, flush=True)
    return row


def _tuned(seeds, pixels, rounds):
    """PSNR on the bench before and after, by a model that is right but knows no source of any size."""
    window, camera = slm.PatternWindow(pixels, PITCH, GREEN), round(1.4 * pixels)
    start = slm.nominal_setup(window, FOCI, (camera, camera), VIEW)
    field, rows = _field(pixels), parameters(start)
    head = ["| seed | " + " | ".join(f"{1e3 * z:g} mm" for z in AT) + " |", "|---" * (1 + len(AT)) + "|"]

    def row(seed):
        bench, truth = slm.perturbed_bench(start, window, seed)
        bench = replace(bench, source=THIRD)
        found = slm.FitResult(truth, rows, vector(truth), np.zeros(len(rows)), 0.0, 1.0)
        calibration = slm.calibration_of(found, window)
        levels = calibration.levels_of(field.hologram)
        phase = engine.encode(field, "joint", display=calibration.display([GREEN]), levels=levels)
        tuned = slm.tune(phase, field, bench.capture_values, calibration, GREEN, rounds)
        cells = [
            ", ".join(f"{_on_bench(bench, field, calibration, each, z):.1f}" for each in (phase, tuned))
            for z in AT
        ]
        text = f"| {seed} | {' | '.join(cells)} |"
        print(text, file=sys.stderr, flush=True)
        return text

    tuned_rows = {f"seed {seed}": lambda seed=int(seed): row(seed) for seed in seeds}
    return joined({"head": lambda: "\n".join(head)} | tuned_rows)


def _as_found(found, truth: Setup):
    return slm.FitResult(truth, found.parameters, vector(truth), np.zeros_like(found.deviations), 0.0, 1.0)


def _field(pixels):
    """Frames of one even gradient, each with random phases."""
    rng = np.random.default_rng(0)
    rows, columns = np.indices((pixels, pixels)) / pixels
    amplitude = 0.4 + 0.5 * rows + 0.3 * np.sin(6 * columns)
    light = amplitude * np.exp(2j * np.pi * rng.random((FRAMES, 1, pixels, pixels)))
    volume = engine.Hologram(pixels, pixels, PITCH, (GREEN,), depth_far=FOCI[0], depth_near=FOCI[-1])
    return engine.WaveField(light.astype(np.complex64), volume, engine.Camera(np.eye(4), 0.6), 0.5)


def _decibels(bench, field, calibration):
    """Of the picture on the bench, without its camera, against the field's own."""
    levels = {"levels": calibration.levels_of(field.hologram)} if calibration.models else {}
    phase = engine.encode(field, "joint", display=calibration.display([GREEN]), **levels)
    return _on_bench(bench, field, calibration, phase, MIDDLE)


def _on_bench(bench, field, calibration, phase, distance):
    shown = [bench.phases[calibration.levels(frame[0], GREEN)] for frame in phase.data]
    seen = np.mean([bench.picture(phases, distance) for phases in shown], axis=0)
    wanted = engine.reconstruct(field, [float(field.mapping.z_to_depth(distance))])[0]
    return metrics.psnr(seen[..., None], wanted, border=4)
