"""From complex fields to the phases that an SLM shows (paper section 5, Phase-only Hologram Encoding)."""

from .encoder import STARTS, SUPERVISIONS, encode
from .phase_hologram import PhaseHologram

__all__ = ["STARTS", "SUPERVISIONS", "PhaseHologram", "encode"]
