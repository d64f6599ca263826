"""Every plugin of the installed Mitsuba with its parameters, and what HoloPath makes of each.

`PLUGINS` has a row for each plugin that a scene file may name, `COMMON` what all plugins of a kind take besides. The
page docs/mitsuba.md is made from it, and a test fails where the installed Mitsuba has a plugin, or a plugin has a word,
that the table lacks. Parameters are those of Mitsuba 3.9.1, by its documentation and source.
"""

from dataclasses import dataclass

CARRIED, NOTED, REFUSED, WITHOUT_EFFECT = "carried", "noted", "refused", "without effect"


@dataclass(frozen=True)
class Plugin:
    """What HoloPath makes of a plugin and of its parameters.

    Attributes
    ----------
    kind : str
        Name in Mitsuba's `ObjectType`.
    outcome : str
        Of the plugin: `CARRIED`, `NOTED`, `REFUSED` or `WITHOUT_EFFECT`.
    carried, noted, without_effect : tuple of str
        Its parameters, besides those that are common to its kind. A parameter of a plugin that is refused counts as
        carried, as it never comes to it.
    """

    kind: str
    outcome: str
    carried: tuple = ()
    noted: tuple = ()
    without_effect: tuple = ()

    @property
    def parameters(self) -> set:
        """All of its own."""
        return {*self.carried, *self.noted, *self.without_effect}


def _row(kind, outcome=CARRIED, carried="", noted="", without_effect=""):
    return Plugin(kind, outcome, *(tuple(names.split()) for names in (carried, noted, without_effect)))


def _bsdf(carried="", without_effect="", outcome=CARRIED):
    return _row("BSDF", outcome, carried, "", without_effect)


def _shape(carried="", outcome=CARRIED, **more):
    return _row("Shape", outcome, carried, **more)


def _mesh(carried=""):
    return _shape(f"{carried} face_normals flip_normals")


def _emitter(carried="", without_effect="", outcome=CARRIED):
    return _row("Emitter", outcome, carried, "", without_effect)


def _texture(carried="", without_effect="", outcome=CARRIED, kind="Texture"):
    return _row(kind, outcome, carried, "", without_effect)


def _unseen(kind, names=""):
    return _row(kind, WITHOUT_EFFECT, without_effect=names)


# What every plugin of a kind takes.
COMMON = {
    "Shape": _shape("to_world", noted="interior exterior", without_effect="silhouette_sampling_weight"),
    "Emitter": _emitter("to_world", "sampling_weight"),
    "Volume": _texture("to_world", kind="Volume"),
    "Sensor": _row("Sensor", CARRIED, "to_world near_clip far_clip", "srf", "shutter_open shutter_close"),
    "Film": _row(
        "Film",
        CARRIED,
        "width height crop_width crop_height crop_offset_x crop_offset_y",
        without_effect="sample_border",
    ),
    "Sampler": _unseen("Sampler", "sample_count seed"),
    "Integrator": _row(
        "Integrator",
        WITHOUT_EFFECT,
        "max_depth",
        "hide_emitters",
        "rr_depth samples_per_pass block_size timeout",
    ),
    "Scene": _unseen(
        "Scene",
        "allow_thread_reordering compact_acceleration_structures embree_use_robust_intersections kd_clip "
        "kd_empty_space_bonus kd_exact_primitive_threshold kd_intersection_cost kd_max_depth kd_min_max_bins "
        "kd_retract_bad_splits kd_stop_prims kd_traversal_cost",
    ),
}

_IOR = "int_ior ext_ior specular_reflectance"
_ROUGH = "distribution alpha alpha_u alpha_v"
_SKY = "turbidity albedo latitude longitude timezone sun_scale sky_scale sun_aperture"
_SPLATS = (
    "filename data centers scales quaternions scale_factor extent extent_adaptive_clamping center scale quaternion "
    "opacity f_dc_0"
)
PLUGINS = {
    # BSDFs
    "blendbsdf": _bsdf("weight"),
    "bumpmap": _bsdf("scale flip_invalid_normals use_shadowing_function"),
    "circular": _bsdf("transmittance left_handed", outcome=NOTED),
    "conductor": _bsdf("material eta k specular_reflectance"),
    "dielectric": _bsdf(f"{_IOR} specular_transmittance"),
    "diffuse": _bsdf("reflectance"),
    "hair": _bsdf(
        "eumelanin pheomelanin sigma_a scale int_ior ext_ior longitudinal_roughness azimuthal_roughness scale_tilt "
        "use_pigmentation"
    ),
    "mask": _bsdf("opacity"),
    "measured": _bsdf("filename"),
    "measured_polarized": _bsdf("filename alpha_sample wavelength", outcome=REFUSED),
    "normalmap": _bsdf("normalmap flip_invalid_normals use_shadowing_function"),
    "null": _bsdf(),
    "plastic": _bsdf(f"{_IOR} diffuse_reflectance nonlinear"),
    "polarizer": _bsdf("theta transmittance polarizing", outcome=NOTED),
    "pplastic": _bsdf(f"{_IOR} diffuse_reflectance {_ROUGH}", "sample_visible"),
    "principled": _bsdf(
        "base_color roughness anisotropic metallic spec_trans eta specular spec_tint sheen sheen_tint flatness "
        "clearcoat clearcoat_gloss",
        "diffuse_reflectance_sampling_rate main_specular_sampling_rate clearcoat_sampling_rate",
    ),
    "principledthin": _bsdf(
        "base_color roughness anisotropic spec_trans eta spec_tint sheen sheen_tint flatness diff_trans",
        "diffuse_reflectance_sampling_rate specular_reflectance_sampling_rate specular_transmittance_sampling_rate "
        "diffuse_transmittance_sampling_rate",
    ),
    "retarder": _bsdf("theta delta transmittance", outcome=NOTED),
    "roughconductor": _bsdf(f"material eta k specular_reflectance {_ROUGH}", "sample_visible"),
    "roughdielectric": _bsdf(f"{_IOR} specular_transmittance {_ROUGH}", "sample_visible"),
    "roughplastic": _bsdf(f"{_IOR} diffuse_reflectance nonlinear {_ROUGH}", "sample_visible"),
    "thindielectric": _bsdf(f"{_IOR} specular_transmittance"),
    "twosided": _bsdf("allow_transmission"),
    # shapes
    "blender": _shape(
        "name loop_tri_count loop_tris loops mat_indices mat_nr normals polys sharp_face uvs version vert_count verts",
        REFUSED,
    ),
    "bsplinecurve": _shape("filename"),
    "cube": _mesh(),
    "cylinder": _shape("p0 p1 radius flip_normals"),
    "disk": _shape("flip_normals"),
    "ellipsoids": _shape(_SPLATS, NOTED),
    "ellipsoidsmesh": _shape(f"{_SPLATS} shell", NOTED),
    "instance": _shape(),
    "linearcurve": _shape("filename"),
    "merge": _shape(),
    "obj": _mesh("filename flip_tex_coords"),
    "ply": _mesh("filename flip_tex_coords"),
    "rectangle": _mesh(),
    "sdfgrid": _shape("filename grid normals"),
    "serialized": _mesh("filename shape_index"),
    "shapegroup": _shape(),
    "sphere": _shape("center radius flip_normals"),
    # emitters
    "area": _emitter("radiance"),
    "constant": _emitter("radiance"),
    "directional": _emitter("irradiance direction"),
    "directionalarea": _emitter("radiance", outcome=NOTED),
    "envmap": _emitter("filename bitmap data scale", "mis_compensation"),
    "point": _emitter("intensity position"),
    "projector": _emitter("irradiance scale fov focal_length fov_axis"),
    "spot": _emitter("intensity cutoff_angle beam_width texture"),
    "sunsky": _emitter(f"{_SKY} year month day hour minute second sun_direction complex_sun"),
    "timed_sunsky": _emitter(
        f"{_SKY} window_start_time window_end_time start_year start_month start_day end_year end_month end_day "
        "shutter_open shutter_close complex_sun",
        outcome=REFUSED,
    ),
    # textures and spectra
    "bitmap": _texture("filename bitmap data filter_type wrap_mode raw to_uv", "accel format"),
    "blackbody": _texture("temperature wavelength_min wavelength_max", outcome=REFUSED),
    "checkerboard": _texture("color0 color1 to_uv"),
    "d65": _texture("color scale"),
    "irregular": _texture("value values wavelengths", outcome=REFUSED),
    "mesh_attribute": _texture("name scale"),
    "rawconstant": _texture("value"),
    "regular": _texture("value values wavelength_min wavelength_max range", outcome=REFUSED),
    "srgb": _texture("color unbounded"),
    "uniform": _texture("value", "wavelength_min wavelength_max"),
    "volume": _texture("volume"),
    # media, as clear
    "blendphase": _row("PhaseFunction", NOTED, noted="weight"),
    "constvolume": _texture("value", kind="Volume"),
    "gridvolume": _texture(
        "filename grid data use_grid_bbox filter_type wrap_mode raw max_value", "accel", kind="Volume"
    ),
    "heterogeneous": _row(
        "Medium", NOTED, noted="albedo sigma_t scale has_spectral_extinction sample_emitters"
    ),
    "hg": _row("PhaseFunction", NOTED, noted="g"),
    "homogeneous": _row(
        "Medium", NOTED, noted="albedo sigma_t scale has_spectral_extinction sample_emitters"
    ),
    "isotropic": _row("PhaseFunction", NOTED),
    "rayleigh": _row("PhaseFunction", NOTED),
    "sggx": _row("PhaseFunction", NOTED, noted="S diffuse"),
    "tabphase": _row("PhaseFunction", NOTED, noted="values"),
    # sensors
    "batch": _row("Sensor", REFUSED),
    "distant": _row("Sensor", REFUSED, "direction target"),
    "irradiancemeter": _row("Sensor", REFUSED),
    "orthographic": _row("Sensor", REFUSED, "focus_distance"),
    "perspective": _row(
        "Sensor",
        CARRIED,
        "fov focal_length fov_axis principal_point_offset_x principal_point_offset_y",
        without_effect="focus_distance",
    ),
    "radiancemeter": _row("Sensor", REFUSED, "origin direction"),
    "thinlens": _row("Sensor", NOTED, "fov focal_length fov_axis", "aperture_radius focus_distance"),
    # films: replaced, but for their size
    "hdrfilm": _row("Film", CARRIED, "", "pixel_format", "file_format component_format banner compensate"),
    "specfilm": _row("Film", NOTED, "", "", "component_format compensate"),
    # what computes Mitsuba's picture
    "aov": _unseen("Integrator", "aovs"),
    "depth": _row("Integrator", NOTED),
    "direct": _unseen("Integrator", "shading_samples emitter_samples bsdf_samples"),
    "moment": _unseen("Integrator"),
    "path": _unseen("Integrator"),
    "ptracer": _unseen("Integrator"),
    "stokes": _unseen("Integrator"),
    "volpath": _unseen("Integrator"),
    "volpathmis": _unseen("Integrator", "use_spectral_mis"),
    "independent": _unseen("Sampler"),
    "ldsampler": _unseen("Sampler"),
    "multijitter": _unseen("Sampler", "jitter"),
    "orthogonal": _unseen("Sampler", "jitter strength"),
    "stratified": _unseen("Sampler", "jitter"),
    "box": _unseen("ReconstructionFilter"),
    "catmullrom": _unseen("ReconstructionFilter"),
    "gaussian": _unseen("ReconstructionFilter", "stddev"),
    "lanczos": _unseen("ReconstructionFilter", "lobes"),
    "mitchell": _unseen("ReconstructionFilter", "B C"),
    "tent": _unseen("ReconstructionFilter", "radius"),
}

# Why a parameter is without effect on what a hologram shows.
REASONS = {
    "how Mitsuba draws its samples": "sample_visible sampling_weight silhouette_sampling_weight mis_compensation "
    "diffuse_reflectance_sampling_rate main_specular_sampling_rate clearcoat_sampling_rate "
    "specular_reflectance_sampling_rate specular_transmittance_sampling_rate diffuse_transmittance_sampling_rate "
    "sample_count seed jitter strength rr_depth samples_per_pass block_size timeout shading_samples emitter_samples "
    "bsdf_samples use_spectral_mis",
    "how its files are written": "file_format component_format banner compensate aovs",
    "how its pixels are filtered": "sample_border stddev lobes B C radius",
    "how it stores and finds things": f"accel format {' '.join(COMMON['Scene'].without_effect)}",
    "nothing moves in Mitsuba 3.9": "shutter_open shutter_close",
    "for a lens, which this sensor has not": "focus_distance",
    "Mitsuba in RGB does not read them either": "wavelength_min wavelength_max",
}


def table() -> str:
    """The documentation's table, Markdown."""
    rows = ["| plugin | | carried | with a warning | without effect |", "|---|---|---|---|---|"]
    kinds = list(dict.fromkeys(plugin.kind for plugin in PLUGINS.values()))
    for kind in [*kinds, "Scene"]:
        if kind in COMMON:
            rows.append(_line(f"every {kind}", COMMON[kind], ""))
        rows += [_line(f"`{name}`", row, row.outcome) for name, row in PLUGINS.items() if row.kind == kind]
    return "\n".join(rows)


def reasons() -> str:
    """Why parameters are without effect, Markdown."""
    return "\n".join(f"- {reason}: {_names(names.split())}" for reason, names in REASONS.items())


def _line(name, row, outcome):
    if row.outcome == REFUSED:
        return f"| {name} | {outcome} | | | |"
    return (
        f"| {name} | {outcome} | {_names(row.carried)} | {_names(row.noted)} | {_names(row.without_effect)} |"
    )


def _names(names):
    return ", ".join(f"`{name}`" for name in names)
