"""From complex fields to the phases that an SLM shows (paper section 5, Phase-only Hologram Encoding), or a film."""

from .encoder import STARTS, SUPERVISIONS, encode
from .interference import interference
from .phase_hologram import PhaseHologram

__all__ = ["STARTS", "SUPERVISIONS", "PhaseHologram", "encode", "interference"]
