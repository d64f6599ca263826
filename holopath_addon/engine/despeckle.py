"""Less speckle in one scene's fields: gradient steps towards the mean of many frames (docs/theory.md, Despeckling)."""

import math

import numpy as np
import scipy.fft

from .phase_fields import SETS, designed_phasors
from .propagation import circular_band, padded_shape, transfer_function
from .supervision import Adam, Frames, View, relative, supervise

BATCHES = 4  # of the largest designed set, whose mean is what the picture should be
PUPILS = 2  # parts of the pupil looked through at each depth, besides the whole
PART = 0.5  # radius of a part, of the pupil's
RATE = 0.05  # longest step, of the field's root mean square
VIEWS = 2  # pictures looked at in each step


def batch_phasors(number):
    """Phasors of a batch of the many frames, `number` in 0..BATCHES - 1."""
    return designed_phasors(SETS[-1], seed=1 + number)


class Targets:
    """What is wanted: pictures in one wavelength, at depths of the volume and through parts of the pupil.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the fields.
    pitch, wavelength : float
        Metres.
    low, high : float
        Depths that the pictures cover, relative to the fields' plane, metres.
    seed : int
        Of the parts of the pupil.
    """

    def __init__(self, shape, pitch, wavelength, low, high, seed):
        self.shape, self.pitch, self.wavelength = shape, pitch, wavelength
        self.padded = padded_shape(shape, pitch, wavelength, max(abs(low), abs(high)))
        slope = math.tan(math.asin(wavelength / (2 * pitch)))
        depths = np.linspace(low, high, 2 + math.ceil((high - low) * slope**2 / wavelength))
        rng = np.random.default_rng(seed)
        self.pictures = []
        for depth in depths:
            self.pictures.append((depth, None))
            for _ in range(PUPILS):
                aside = 0.5 * (1 - PART) * math.sqrt(rng.random())
                angle = 2 * math.pi * rng.random()
                self.pictures.append((depth, (aside * math.cos(angle), aside * math.sin(angle))))
        self.band = circular_band(self.padded)
        self.sums = np.zeros((len(self.pictures), *shape), np.float32)
        self.energy, self.frames = 0.0, 0

    def transfer(self, number):
        """From the fields' spectra to the spectrum of a picture."""
        depth, centre = self.pictures[number]
        transfer = transfer_function(self.padded, self.pitch, self.wavelength, depth)
        if centre is not None:
            fy, fx = (scipy.fft.fftfreq(n) for n in self.padded)
            transfer *= np.hypot(fx[None, :] - centre[0], fy[:, None] - centre[1]) <= 0.5 * PART
        return transfer

    def spectra(self, fields, threads):
        """Spectra of fields of shape (frames, y, x), cut to the band."""
        return threads.each(lambda n: scipy.fft.fft2(fields[n], self.padded) * self.band, len(fields))

    def add(self, fields):
        """Count frames towards the wanted pictures; fields of shape (frames, y, x)."""
        rows, columns = self.shape
        with Frames() as threads:
            spectra = self.spectra(fields, threads)

            def picture(number):
                transfer = self.transfer(number)
                for spectrum in spectra:
                    wave = scipy.fft.ifft2(spectrum * transfer)[:rows, :columns]
                    self.sums[number] += wave.real**2 + wave.imag**2

            threads.each(picture, len(self.pictures))
        self.energy += sum(float(np.vdot(s, s).real) for s in spectra) / self.band.size
        self.frames += len(fields)

    def view(self, number):
        """A picture; what lies outside the fields does not count."""
        rows, columns = self.shape
        wanted = self.sums[number] / self.frames
        target, weight = np.zeros((2, *self.padded), np.float32)
        target[:rows, :columns] = wanted
        weight[:rows, :columns] = relative(wanted)
        return View(self.transfer(number), target, weight)


def despeckle(fields, targets, steps, seed, progress):
    """Fields moved towards the wanted pictures.

    Parameters
    ----------
    fields : numpy.ndarray, complex64, shape (frames, y, x)
        Of one wavelength.
    targets : Targets
    steps : int
    seed : int
        Of the order in which pictures are looked at.
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    numpy.ndarray, complex64, as `fields`
    """
    rows, columns = targets.shape
    if not targets.energy:
        return fields
    rng = np.random.default_rng(seed)
    fields = np.array(fields, order="C")
    values = fields.view(np.float32)
    adam = Adam(values.shape)
    longest = RATE * math.sqrt(float(np.mean(values**2)))
    energy = targets.energy / targets.frames
    with Frames() as threads:
        for step in range(steps):
            spectra = targets.spectra(fields, threads)
            views = [targets.view(v) for v in rng.choice(len(targets.pictures), VIEWS, replace=False)]
            _, gradient = supervise(spectra, views, energy, {len(fields): 1.0}, threads)

            def slope(n, gradient=gradient):
                part = scipy.fft.ifft2(gradient[n], norm="forward")[:rows, :columns]
                return 2 * np.ascontiguousarray(part).view(np.float32)

            slopes = threads.each(slope, len(fields))
            adam.step(values, slopes, Adam.rate(step, steps, longest), threads)
            progress((step + 1) / steps)
        # the loss leaves the scale of the fields free
        spectra = targets.spectra(fields, threads)
    now = sum(float(np.vdot(s, s).real) for s in spectra) / (targets.band.size * len(fields))
    return fields * np.float32(math.sqrt(energy / now))
