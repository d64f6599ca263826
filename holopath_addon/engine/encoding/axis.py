"""Off-axis encoding: gain and cost of a stop beside the zero order with each encoding."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..hologram import Hologram


def on_axis(method: str, bits: int | None, hologram: Hologram) -> str:
    """Reason for, or loss by, phases on axis if no carrier and no stop were given; a clause.

    Measured: docs/how-to/bench.md, Off axis. Double phase leaves stray light within the band, which a stop of half its
    radius blocks. Descents compensate for it; all frames together also for the twin image of one bit, where the
    narrower pupil costs more.

    Parameters
    ----------
    method : str
        One of `ENCODINGS`, but not ``auto``.
    bits : int or None
        Bits of the panel.
    hologram : Hologram

    Returns
    -------
    str
        Empty if a carrier or a stop was given, if a lens's image leaves no choice, or if there is no difference.
    """
    if hologram.optics.stopped or hologram.in_air is not hologram:
        return ""
    if method == "dpac":
        return (
            "double phase leaves stray light in the image on axis: with `--carrier auto` it showed up to 7 dB more, "
            "through a pupil half as wide"
        )
    if bits == 1 and method == "refine":
        return (
            "with one bit phases are optimized to compensate for the twin image: without it, by `--carrier auto`, they "
            "showed 2 to 6 dB more through a pupil half as wide, and 1 dB less to 2 more than the whole pupil on axis"
        )
    if bits == 1 and method != "sgd":  # which shows the same with and without the twin
        return (
            "with one bit phases are optimized to compensate for the twin image: without it, by `--carrier auto`, they "
            "showed 1 to 2.5 dB less, through a pupil half as wide"
        )
    return ""
