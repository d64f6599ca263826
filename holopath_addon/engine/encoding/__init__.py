"""Encoding of complex fields as phases for an SLM (paper section 5, Phase-only Hologram Encoding), or for a film."""

from .encoder import encode
from .interference import interference
from .options import STARTS, SUPERVISIONS
from .phase_hologram import PhaseHologram

__all__ = ["STARTS", "SUPERVISIONS", "PhaseHologram", "encode", "interference"]
