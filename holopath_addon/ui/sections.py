"""Sections of the panels: functions that draw into any `layout`, in the context of a panel."""

from contextlib import suppress
from typing import Any

import bpy
from bpy.types import Context, UILayout

from .. import engine
from ..blender import preferences, properties
from ..blender.properties import HoloPathSettings, display_of, pitch_of, property_of
from ..engine.pixels import axes, in_words
from ..engine.progress import duration
from ..engine.settings import DECLARED, ENCODE_SECONDS, EYEBOX
from ..engine.settings.choices import BASELINES, ENCODINGS
from ..operators import background, session
from ..operators.rendering import output_size, own_size
from ..workflow import pipeline
from .focus_list import HOLOPATH_UL_focus
from .text import alert, count, wrapped


def summary(layout: UILayout, context: Context) -> None:
    """Resolution, pitch, frames and wavelengths, in two lines."""
    props = properties.of(context.scene)
    frames = f"Frames for {props.speckle:.0%} Speckle" if props.wish_speckle else count(props.frames, "Frame")
    column = layout.column(align=True)
    wrapped(
        column, context, f"{props.resolution_x} × {props.resolution_y} px, {in_words(pitch_of(props))} Pitch"
    )
    wrapped(column, context, f"{frames}, {'RGB' if props.colors == 'RGB' else f'{props.wavelength_nm:g} nm'}")


def display(layout: UILayout, context: Context) -> None:
    """Resolution, pitch, bits and wavelengths."""
    props = properties.of(context.scene)
    layout.prop(props, "display")
    if display_of(props) is None:
        column = layout.column(align=True)
        column.prop(props, "resolution_x", text="Resolution X")
        column.prop(props, "resolution_y", text="Y")
        row = layout.row(align=True)
        row.prop(props, "pitch_um")
        linked = "LINKED" if props.square_pixels else "UNLINKED"
        row.prop(props, "square_pixels", text="", icon=linked)
        if not props.square_pixels:
            layout.prop(props, "pitch_y_um", text="Y")
        layout.prop(props, "bits")
        bits = ""
    else:  # set by the display
        wrapped(
            layout,
            context,
            f"{props.resolution_x} × {props.resolution_y} px, {in_words(pitch_of(props))} Pitch",
        )
        bits = f"{count(props.bits, 'Bit')}, "
    down, across = (d * 1e3 for d in axes(pitch_of(props)))
    width, height = props.resolution_x * across, props.resolution_y * down
    wrapped(layout, context, f"{bits}Size {width:.3g} × {height:.3g} mm")
    column = layout.column()
    column.row().prop(props, "colors", expand=True)
    if props.colors == "RGB":
        for index, color in enumerate(("Red", "Green", "Blue")):
            column.prop(props, "wavelengths_nm", index=index, text=f"{color} (nm)")
    else:
        column.prop(props, "wavelength_nm")


def depth(layout: UILayout, context: Context) -> None:
    """Mapping of the scene's depth to the hologram's volume, and the focus list."""
    props = properties.of(context.scene)
    layout.prop(props, "depth_mapping")
    layout.prop(props, "depth_auto")
    if properties.depth_is_auto(props):
        with suppress(engine.InvalidInput, engine.BackendUnavailable):
            hologram = properties.hologram_of(props)
            ends = (
                f"{hologram.depth_far * 1e3:.3g} to {hologram.depth_near * 1e3:.3g} mm from {hologram.origin}"
            )
            wrapped(layout, context, ends)
    else:
        column = layout.column(align=True)
        column.prop(props, "depth_far_mm")
        column.prop(props, "depth_near_mm")
    with suppress(engine.InvalidInput, engine.BackendUnavailable):
        hologram = properties.hologram_of(props)
        warning = hologram.lost_light(max(hologram.depth_far, hologram.depth_near, key=abs))
        if warning:
            wrapped(layout, context, f"{warning}.", icon="ERROR")
    if props.depth_mapping == "eyepiece":
        wrapped(layout, context, "Near End: Set by Eyepiece", icon="INFO")
    else:
        layout.prop(props, "near_auto")
        plan = session.plan_of(context.scene)
        if not props.near_auto:
            layout.prop(props, "near")
        elif plan is None:
            wrapped(layout, context, "Near: Not Estimated Yet", icon="INFO")
        else:
            wrapped(layout, context, f"Near: {plan.near:.3g} m at Last Estimate")
    layout.use_property_split = False
    layout.label(text="Focus List (m, D)")
    row = layout.row()
    row.template_list(
        HOLOPATH_UL_focus.__name__, "", props, "focus_list", props, "focus_index", rows=3, maxrows=6
    )
    column = row.column(align=True)
    column.operator("holopath.focus_list_add", text="", icon="ADD")
    column.operator("holopath.focus_list_remove", text="", icon="REMOVE")
    column.separator()
    column.operator("holopath.focus_list_from_selected", text="", icon="OBJECT_DATA")
    column.operator("holopath.focus_list_sort", text="", icon="SORTSIZE")
    layout.prop(props, "show_overlay")


def quality(layout: UILayout, context: Context) -> None:
    """Quality, number of frames, and source of light."""
    _declared(layout, properties.of(context.scene), "quality")


def advanced(layout: UILayout, context: Context) -> None:
    """Parts of the method, each with the paper's choice."""
    props = properties.of(context.scene)
    if props.method in BASELINES:
        wrapped(layout, context, f"For Comparison: {_method(props)} Uses Few Settings", icon="INFO")
    elif props.method == "direct":
        wrapped(layout, context, "Estimator: Paper, by Method Direct", icon="INFO")
    _declared(layout, props, "advanced")


# Conditions under which settings have an effect.
_IN_EFFECT = {
    "frames": lambda props: not props.wish_speckle,
    "estimator": lambda props: props.method != "direct",
    "paths": lambda props: props.radiance == "ray",
    "virtual_image": lambda props: props.max_specular_depth > 0,
    "planes": lambda props: props.wrp_auto,
    "randomness": properties.may_be_smooth,
}


def _declared(layout, props, section):
    """Draw the settings of a section that have an effect."""
    for name, declared in DECLARED.items():
        if declared.section != section or not _IN_EFFECT.get(name, bool)(props):
            continue
        if section == "advanced" and props.method in BASELINES and name not in ("seed", "spp"):
            continue
        _setting(layout, props, property_of(name), declared)


def _setting(layout, props, name, declared):
    """A setting's property, after its switch if it has one."""
    switch = declared.switch
    if switch is None:
        layout.prop(props, name)
        return
    row = layout.row(heading=switch.heading)
    row.prop(props, switch.name, text="" if switch.by_hand else "Automatic")
    if getattr(props, switch.name) == switch.by_hand:
        row.prop(props, name, text=declared.unit)


def baked_light(layout: UILayout, context: Context) -> None:
    """Baked light, and the buttons for it."""
    bake, size = session.bake_of(context.scene), preferences.store().size()
    layout.use_property_split = False
    row = layout.row(align=True)
    row.operator("holopath.bake", text="Rebake" if bake else "Bake", icon="RENDER_STILL").anew = bool(bake)
    if bake and session.texture_of(context.scene) is None:  # baked by a render, which keeps no image of it
        row.operator("holopath.bake", text="Show Texture", icon="TEXTURE").show = True
    else:
        row.operator("holopath.show_texture", icon="TEXTURE")
    row = layout.row(align=True)
    row.label(text=f"On Disk: {size / 1e6:.1f} MB")
    row.operator("holopath.clear_baked", icon="TRASH")
    props = properties.of(context.scene)
    if props.method in {"full", "direct", *BASELINES}:
        wrapped(layout, context, f"Not Used by Method {_method(props)}", icon="INFO")
    if bake is None:
        wrapped(layout, context, "Nothing Baked in This Session")
        return
    source = {"all": "Loaded From Disk", "part": "Partly Loaded From Disk"}.get(bake["reused"], "Baked Anew")
    seconds = sum(bake["seconds"].values())
    size = f", {bake['bytes'] / 1e6:.1f} MB" if bake["bytes"] else ""
    column = layout.column(align=True)
    wrapped(column, context, f"{bake['texels']:,} Texels in View{size}")
    wrapped(column, context, f"{source}: {seconds:.1f} s")
    for note in pipeline.bake_notes(bake):
        wrapped(layout, context, note, icon="INFO")


def material(layout: UILayout, context: Context) -> None:
    """HoloPath's settings of a material beyond its nodes."""
    layout.prop(properties.of_material(context.material), "abbe_number")


def render(layout: UILayout, context: Context) -> None:
    """Button or progress, and what to install if no processor can compute."""
    job = session.current.job
    layout.use_property_split = False
    missing = preferences.backend_problem()
    if missing:
        alert(layout.box(), context, missing)
        row = layout.row(align=True)
        row.operator("holopath.check", icon="FILE_REFRESH")
        show = row.operator("preferences.addon_show", text="Preferences", icon="PREFERENCES")
        show.module = preferences.ADDON
    column = layout.column(align=True)
    if job is not None and job.running:
        column.progress(factor=job.done, text=session.progress_text(job))
        row = column.row()
        row.enabled = not job.canceling
        row.operator("holopath.cancel", icon="CANCEL")
    else:
        column.enabled = not missing
        column.scale_y = 2.0  # as high as both, so that what is below stays where it is
        column.operator("holopath.render_hologram", icon="RENDER_STILL")
    if not missing:
        failure(layout, context)
    f12(layout, context)
    noted = len(session.current.notes)
    if noted and session.plan_of(context.scene) is not None:
        wrapped(layout, context, f"{count(noted, 'Export Note')}: Features Approximated", icon="INFO")


def animation(layout: UILayout, context: Context) -> None:
    """Button or progress of the animation, and the result of the last one."""
    props = properties.of(context.scene)
    layout.prop(props, "animation_folder", text="Folder")
    layout.prop(props, "animation_encodes")
    if props.animation_encodes and props.encoding != "dpac":
        layout.prop(props, "animation_in_turn")
    layout.use_property_split = False
    work = background.current
    column = layout.column(align=True)
    if background.running():
        column.progress(factor=work.done, text=_frames_text(work))
        row = column.row()
        row.enabled = not work.canceled
        row.operator("holopath.cancel_animation", text="Cancel", icon="CANCEL")
    else:
        column.scale_y = 2.0  # as high as both
        column.operator("holopath.render_animation", icon="RENDER_ANIMATION")
    _animation_state(layout, context, work)


def _frames_text(work):
    """Progress in words: ``Frame 12 of 250, 3 min left``, or before that ``Light of 250 Frames``."""
    if work.canceled:
        return "Canceling…"
    if work.lighting:
        return f"Light of {count(work.count, 'Frame')}"
    seconds = work.remaining
    return f"Frame {work.frame} of {work.count}" + ("" if seconds is None else f", {duration(seconds)} left")


def _animation_state(layout, context, work):
    column = layout.column(align=True)
    if background.running():
        wrapped(column, context, f"{work.message}…")
    elif work.error:
        alert(column, context, work.error)
    elif work.canceled:
        wrapped(
            column, context, f"Canceled: {work.finished} of {count(work.count, 'Frame')} Done", icon="INFO"
        )
    elif work.count:
        wrapped(column, context, f"{count(work.count, 'Frame')} Done", icon="CHECKMARK")
    else:
        frames = len(background.frames_of(context.scene))
        wrapped(column, context, f"{count(frames, 'Frame')}, in the Background")
    if work.file and work.file != bpy.path.basename(bpy.data.filepath or "untitled.blend"):
        wrapped(column, context, f"Of {work.file}")
    elif work.scene and context.scene is not None and work.scene != context.scene.name:
        wrapped(column, context, f"Of Scene '{work.scene}'")
    if preferences.cluster():
        wrapped(column, context, f"By {preferences.cluster()}", icon="NETWORK_DRIVE")
    for note in work.notes:
        wrapped(layout, context, note, icon="DOT")


def failure(layout: UILayout, context: Context) -> None:
    """Last failure, if there was one."""
    if session.current.error:
        alert(layout, context, session.current.error)


def f12(layout: UILayout, context: Context) -> None:
    """Size of F12's picture, and a button that matches it to the hologram's."""
    if context.scene is None or context.scene.render.engine != "HOLOPATH":
        return
    size = output_size(context.scene)
    if size == own_size(context.scene):
        wrapped(layout, context, "F12: Same Size", icon="CHECKMARK")
        return
    wrapped(layout, context, f"F12: {size[0]} × {size[1]} px (Output)", icon="INFO")
    layout.operator("holopath.match_output", icon="OUTPUT")


def reconstruct(layout: UILayout, context: Context) -> None:
    """Focus and pupil of the reconstruction, and the wave field."""
    props = properties.of(context.scene)
    layout.use_property_split = False
    column = layout.column(align=True)
    row = column.row(align=True)
    row.prop(props, "focus_auto", toggle=True)
    row.operator("holopath.focus_from_selected", text="On Object", icon="OBJECT_DATA")
    row.prop(props, "focus_infinity", text="∞", toggle=True)
    distance = column.column(align=True)
    distance.active = not props.focus_infinity
    distance.prop(props, "focus")
    column.prop(props, "focus_diopters", slider=True)
    layout.prop(props, "use_pupil", text="Partial Pupil")
    if props.use_pupil:
        column = layout.column(align=True)
        column.prop(props, "pupil_offset_mm", index=0, text="Right (mm)")
        column.prop(props, "pupil_offset_mm", index=1, text="Up (mm)")
        column.prop(props, "pupil_diameter_mm")
    field = session.current.field
    if field is None:
        wrapped(layout, context, "No Wave Field Yet", icon="INFO")
        return
    row = layout.row(align=True)
    row.operator("holopath.refocus", icon="FILE_REFRESH")
    playing = session.current.sweep_timer is not None
    row.operator(
        "holopath.sweep", text="Stop" if playing else "Play Focus", icon="PAUSE" if playing else "PLAY"
    )
    layout.operator("holopath.save_field", icon="FILE_TICK")
    hologram = field.hologram
    name = session.current.field_scene
    suffix = "" if context.scene is None or name == context.scene.name else f", Scene '{name}'"
    kind, column = "Draft" if session.current.draft else "Wave Field", layout.column(align=True)
    wrapped(column, context, f"{kind}: {hologram.width} × {hologram.height} px{suffix}")
    colors = count(len(hologram.wavelengths), "Wavelength")
    wrapped(column, context, f"{colors}, {count(len(field.data), 'Frame')}")


def hologram(layout: UILayout, context: Context) -> None:
    """Phases that an SLM shows: encoding, frame and display."""
    props = properties.of(context.scene)
    layout.prop(props, "encoding")
    if props.encoding != "dpac":
        _setting(layout, props, "encode_seconds", ENCODE_SECONDS)
    if props.encoding not in ("dpac", "sgd"):
        _setting(layout, props, "eyebox", EYEBOX)
    _encoding(layout, context)
    layout.operator("holopath.encode", icon="IMAGE_ALPHA")
    phase = session.current.phase
    if phase is None:
        text = "No Wave Field Yet" if session.current.field is None else "Not Encoded Yet"
        wrapped(layout, context, text, icon="INFO")
        return
    if len(phase.data) > 1:
        layout.prop(props, "phase_frame", text=f"Frame (0–{len(phase.data) - 1})")
    layout.prop(props, "refocused")
    encoding = session.current.phase_encoding
    if props.refocused == "PHASE" and encoding is not None and encoding.display is not None:
        wrapped(layout, context, "Shown by the Fitted Display", icon="INFO")
    elif props.refocused == "PHASE":
        column = layout.column(align=True)
        column.prop(props, "pixel_shape")
        if props.pixel_shape:
            column.prop(props, "fill_factor")
        column.prop(props, "unmodulated")
        column.prop(props, "crosstalk")
    layout.operator("holopath.save_hologram", icon="FILE_TICK")


def _encoding(layout, context):
    """Draw the plan of encoding, and the use of more seconds, if there is a plan."""
    try:
        plan = session.encoding_of(context.scene)
        if plan is None:
            return
        warnings = plan.memory_warnings()
    except engine.InvalidInput as error:
        alert(layout, context, str(error))
        return
    column = layout.column(align=True)
    label = ENCODINGS[plan.method].label
    wrapped(column, context, f"{label}: About {duration(plan.seconds)}" if plan.seconds else label)
    if plan.memory_bytes:
        wrapped(column, context, f"Memory: {plan.memory_bytes / 1e6:.0f} MB")
    for warning in warnings:
        wrapped(column, context, warning, icon="ERROR")
    reason = column.column(align=True)
    reason.active = False
    wrapped(reason, context, plan.reason[:1].upper() + plan.reason[1:])
    if plan.advice:
        wrapped(layout, context, plan.advice, icon="INFO")


def estimate(layout: UILayout, context: Context) -> None:
    """Estimated time and memory, and the plan's decisions with their reasons."""
    layout.operator("holopath.plan", icon="TIME")
    plan = session.plan_of(context.scene)
    if plan is None:
        return
    if plan.seconds:  # baselines have no estimate
        column = layout.column(align=True)
        wrapped(column, context, f"Time: About {plan.seconds:.0f} s")
        wrapped(column, context, f"Memory: {plan.memory_bytes / 1e6:.0f} MB")
        wrapped(column, context, f"Noise: {plan.error:.1%} of the Field")
    for warning in plan.warnings:
        wrapped(layout, context, warning, icon="ERROR")
    for decision in plan.decisions:
        column = layout.column(align=True)
        wrapped(column, context, f"{_title(decision.name)}: {decision.value}")
        reason = column.column(align=True)
        reason.active = False
        wrapped(reason, context, decision.why)


def notes(layout: UILayout, context: Context) -> None:
    """Features that the exporter approximated or left out."""
    if session.plan_of(context.scene) is None:
        wrapped(layout, context, "Listed by Estimate and Render")
        return
    if not session.current.notes:
        wrapped(layout, context, "Nothing Approximated or Left Out")
    for note in session.current.notes:
        wrapped(layout, context, note, icon="DOT")


def _method(props: HoloPathSettings) -> str:
    """Label of the chosen method."""
    methods: Any = props.bl_rna.properties["method"]  # an EnumProperty
    return methods.enum_items[props.method].name


def _title(name: str) -> str:
    """Name of a decision in title case: ``settings.phase_field`` is ``Phase Field``."""
    words = name.removeprefix("settings.").replace("_", " ").replace(" a pixel", " per pixel").split()
    small = {"a", "an", "and", "at", "by", "for", "in", "of", "on", "or", "per", "the", "to", "with"}
    return " ".join(
        word if number and word in small else word[:1].upper() + word[1:] for number, word in enumerate(words)
    )
