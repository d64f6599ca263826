"""Presets of phase-only spatial light modulators (SLMs), from their data sheets."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import InvalidInput

ENOUGH_BITS = 8  # bits of phase from which rounding has no visible effect


@dataclass(frozen=True)
class Display:
    """Preset of a phase-only SLM.

    Parameters
    ----------
    name : str
        Key in `DISPLAYS` and value of ``--display``.
    label : str
        Maker and model.
    width, height : int
        Numbers of pixels.
    pitch : float
        Pixel pitch, meters, the same in x and y.
    bits : int
        Bits of phase for each pixel at the device's interface.
    number : int
        Number in .blend files, which never changes.
    depth_range : (float, float)
        Distances from the SLM of the far and the near end of the volume, meters. Default: those of the paper's
        prototype (section 5), whose relay has room for them.
    frames : int
        Number of frames of each color that it shows in 1/60 s, one color after another.
    """

    name: str
    label: str
    width: int
    height: int
    pitch: float
    bits: int
    number: int
    depth_range: tuple[float, float] = (80e-3, 85e-3)
    frames: int = 1

    @property
    def few_bits(self) -> int | None:
        """Bits of the levels that phases are to be optimized for; None if rounding has no visible effect."""
        return self.bits if self.bits < ENOUGH_BITS else None


DISPLAYS = {
    d.name: d
    for d in (
        Display("pluto-2", "HOLOEYE PLUTO-2", 1920, 1080, 8.0e-6, 8, 1),
        Display("leto-3", "HOLOEYE LETO-3", 1920, 1080, 6.4e-6, 8, 2),
        Display("gaea-2", "HOLOEYE GAEA-2", 4160, 2464, 3.74e-6, 8, 3),
        Display("meadowlark-1920", "Meadowlark Optics 1920 x 1152", 1920, 1152, 9.2e-6, 8, 4),
        Display("santec-slm-210", "Santec SLM-210", 1920, 1200, 8.0e-6, 10, 5),
        Display("ti-plm-067", 'Texas Instruments PLM 0.67"', 1358, 800, 10.8e-6, 4, 6, frames=8),
    )
}


def display(name: str) -> Display:
    """Return a preset.

    Parameters
    ----------
    name : str
        Name of the preset; case does not matter.

    Raises
    ------
    InvalidInput
        If there is no such preset; the message lists all.
    """
    try:
        return DISPLAYS[str(name).lower()]
    except KeyError:
        known = ", ".join(DISPLAYS)
        raise InvalidInput(
            f"Expected a display preset, got '{name}'. Choose one of {known}, or give a resolution and pitch."
        ) from None
