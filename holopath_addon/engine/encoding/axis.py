"""On axis or off it: what a stop beside the zero order brings, and costs, with each encoding."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..hologram import Hologram


def on_axis(method: str, bits: int | None, hologram: Hologram) -> str:
    """Why phases are found on axis where no carrier and no stop were given, or what is lost by it; a clause.

    Measured: docs/how-to/bench.md, Off axis. Double phase leaves light astray within the band, which a stop of half its
    radius leaves out. Descents make up for it; all frames together also for the twin of one bit, and there the narrower
    pupil costs more.

    Parameters
    ----------
    method : str
        Of `ENCODINGS`, but not ``auto``.
    bits : int or None
        Of the panel.
    hologram : Hologram

    Returns
    -------
    str
        Empty where a carrier or a stop was given, where a lens's picture leaves no choice, and where there is nothing
        to tell.
    """
    if hologram.optics.stopped or hologram.in_air is not hologram:
        return ""
    if method == "dpac":
        return (
            "double phase leaves light astray in the picture on axis: with `--carrier auto` it showed up to 7 dB more, "
            "through a pupil half as wide"
        )
    if bits == 1 and method == "refine":
        return (
            "with one bit phases are found that make up for the twin: without it, by `--carrier auto`, they showed 2 "
            "to 6 dB more through a pupil half as wide, and 1 dB less to 2 more than the whole pupil on axis"
        )
    if bits == 1 and method != "sgd":  # of which both show as much
        return (
            "with one bit phases are found that make up for the twin: without it, by `--carrier auto`, they showed 1 "
            "to 2.5 dB less, through a pupil half as wide"
        )
    return ""
