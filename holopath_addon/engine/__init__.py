"""The science of HoloPath: plan, trace, propagate, reconstruct.

Imports no bpy, and Mitsuba only when used.
"""

from .camera import Camera
from .displays import DISPLAYS, Display
from .encoding import PhaseHologram, encode, interference
from .errors import BackendUnavailable, Cancelled, InvalidInput
from .hologram import Hologram
from .light.bake_store import BakeStore
from .optics import Beam, Lens, Optics, Pupil, Stop
from .plan import Decision, Plan
from .planning.fixable import FIXABLE, parse_fixed
from .planning.phases import EncodingPlan, axis_decision, extra_frame_count, plan_encoding
from .planning.planner import plan
from .rendering import render
from .rendering.extra_frames import extra_frames
from .scene import variants
from .scene.captured.picture import picture_scene
from .scene.captured.points import point_scene
from .scene.captured.views import view_scene
from .settings import Settings
from .viewing.depth import depth_map
from .viewing.metrics import psnr, psnr_deviation, psnr_of_halves, ssim
from .viewing.preview import Preview
from .viewing.reconstruction import Refocuser, reconstruct, to_rgb
from .viewing.reference import diffracted, reference
from .wavefield import WaveField
from .waves.display_model import DisplayModel
from .waves.modulator import Levels, Modulator
from .waves.panels import at_panel

__all__ = [
    "BackendUnavailable",
    "BakeStore",
    "Beam",
    "Camera",
    "Cancelled",
    "DISPLAYS",
    "Decision",
    "Display",
    "DisplayModel",
    "EncodingPlan",
    "FIXABLE",
    "Hologram",
    "InvalidInput",
    "Lens",
    "Levels",
    "Modulator",
    "Optics",
    "PhaseHologram",
    "Plan",
    "Preview",
    "Pupil",
    "Refocuser",
    "Settings",
    "Stop",
    "WaveField",
    "at_panel",
    "axis_decision",
    "depth_map",
    "diffracted",
    "encode",
    "extra_frame_count",
    "extra_frames",
    "interference",
    "parse_fixed",
    "picture_scene",
    "plan",
    "plan_encoding",
    "point_scene",
    "psnr",
    "psnr_deviation",
    "psnr_of_halves",
    "reconstruct",
    "reference",
    "render",
    "ssim",
    "to_rgb",
    "view_scene",
]

variants.name_own_llvm()  # before anybody imports Mitsuba
