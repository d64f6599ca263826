"""The science of HoloPath: plan, trace, propagate, reconstruct.

Imports no bpy, and Mitsuba only when used.
"""

from .bake_store import BakeStore
from .camera import Camera
from .depth import depth_map
from .displays import DISPLAYS, Display
from .encoding import PhaseHologram, encode
from .errors import BackendUnavailable, Cancelled, InvalidInput
from .hologram import Hologram, Settings
from .metrics import psnr, psnr_deviation, psnr_of_halves, ssim
from .modulator import Modulator
from .planner import FIXABLE, Decision, Plan, parse_fixed, plan
from .preview import Preview
from .reconstruction import Pupil, Refocuser, reconstruct, to_rgb
from .reference import diffracted, reference
from .rendering import render
from .wavefield import WaveField

__all__ = [
    "BackendUnavailable",
    "BakeStore",
    "Camera",
    "Cancelled",
    "DISPLAYS",
    "Decision",
    "Display",
    "FIXABLE",
    "Hologram",
    "InvalidInput",
    "Modulator",
    "PhaseHologram",
    "Plan",
    "Preview",
    "Pupil",
    "Refocuser",
    "Settings",
    "WaveField",
    "depth_map",
    "diffracted",
    "encode",
    "parse_fixed",
    "plan",
    "psnr",
    "psnr_deviation",
    "psnr_of_halves",
    "reconstruct",
    "reference",
    "render",
    "ssim",
    "to_rgb",
]
