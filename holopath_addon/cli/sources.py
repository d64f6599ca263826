"""Sources of scenes: a .blend, a Mitsuba .xml, a demo, an image with depth, a point cloud, or views.

Also opens the scene of a stored field again. bpy is imported only if it is needed.
"""

import contextlib
import glob
import os
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from .. import engine
from ..blender import demo
from ..engine.planning.planner import resolved
from ..engine.scene import variants
from ..engine.scene.captured.views import METHODS as VIEW_METHODS
from ..exchange import captures
from ..exchange.built_scene import BuiltScene
from ..exchange.captures import CaptureOptions
from ..exchange.mitsuba_file import MitsubaFile
from ..farm.processes import uninterrupted
from ..workflow import output

if TYPE_CHECKING:
    import mitsuba as mi


class BlenderSource:
    """The file that is open in bpy, with its HoloPath settings as defaults."""

    def __init__(self):
        from ..export import ExportCache

        self._cache = ExportCache()  # consecutive frames of an animation share most objects
        self._scene, self._layer = "", ""  # names, if they are chosen

    @property
    def scene(self):
        """The `bpy.types.Scene` that was chosen, or else the one in which the file was saved."""
        import bpy

        scene = bpy.data.scenes[self._scene] if self._scene else bpy.context.scene
        assert scene is not None  # every file has one
        return scene

    def choose(self, scene=None, view_layer=None):
        """Choose another scene or view layer of the file.

        Parameters
        ----------
        scene, view_layer : str, optional
            Names. Default: the current scene, and its first view layer that is used for rendering.

        Raises
        ------
        engine.InvalidInput
            If the file has no such scene or view layer.
        """
        import bpy

        for name, choices, kind, flag in (
            (scene, bpy.data.scenes, "scene", "--scene-name"),
            (
                view_layer,
                (bpy.data.scenes.get(scene or "") or self.scene).view_layers,
                "view layer",
                "--view-layer",
            ),
        ):
            if name and name not in choices:
                names = ", ".join(f"'{each.name}'" for each in choices)
                raise engine.InvalidInput(f"There is no {kind} '{name}'. Choose one of {names} with {flag}.")
        self._scene, self._layer = scene or self._scene, view_layer or ""

    def hologram_from(self, camera=None):
        """Hologram by the scene's settings in the current frame.

        Parameters
        ----------
        camera : str, optional
            Has no effect.

        Returns
        -------
        engine.Hologram
        """
        from ..blender import properties

        return properties.hologram_of(properties.of(self.scene))

    @property
    def settings(self):
        """`engine.Settings` in the current frame."""
        from ..blender import properties

        return properties.settings_of(properties.of(self.scene))

    @property
    def frame(self):
        """Number of the current frame."""
        return self.scene.frame_current

    @property
    def frames(self):
        """Numbers of the frames of the animation."""
        scene = self.scene
        return range(scene.frame_start, scene.frame_end + 1, scene.frame_step)

    @property
    def files(self):
        """Paths of the files that make up the scene, existing or not, `pathlib.Path` by name.

        The names are the same on every machine: paths relative to the .blend's folder, or absolute paths as in the
        .blend. Packed files are part of the .blend.
        """
        import bpy

        from ..blender import properties

        blend = Path(bpy.data.filepath)
        if not bpy.data.filepath:
            return {}
        stored = zip(bpy.utils.blend_paths(absolute=True), bpy.utils.blend_paths(absolute=False), strict=True)
        paths = [(Path(path), text.startswith("//")) for path, text in stored]
        bench = properties.optics.files_of(properties.of(self.scene).optics).values()
        paths += [(Path(bpy.path.abspath(text)), text.startswith("//")) for text in bench if text]
        paths += [(blend, True), *((path, True) for path in _baked(blend))]
        sequences = _sequences()
        files = {}
        for path, relative in paths:
            for file in _files_at(path, path in sequences):
                # Windows has no relative path to another drive
                is_beside = relative and file.drive == blend.drive
                name = os.path.relpath(file, blend.parent) if is_beside else str(file)
                files[name.replace(os.sep, "/")] = file
        return files

    def go_to(self, frame):
        """Set the current frame.

        Parameters
        ----------
        frame : int
        """
        # Blender ignores an interrupt within a handler.
        with native_output_to_stderr(), uninterrupted():
            self.scene.frame_set(frame)

    def load(self, width, height, camera=None):
        """Export the current frame.

        Parameters
        ----------
        width, height : int
            Pixels of the image.
        camera : str or engine.Camera, optional
            Name of a camera object, or a camera. Default: the scene's.

        Returns
        -------
        BuiltScene

        Raises
        ------
        engine.InvalidInput, engine.BackendUnavailable
        """
        import bpy

        from ..export import export_scene, show_as_rendered

        scene, layer = self.scene, self._view_layer()
        with bpy.context.temp_override(scene=scene, view_layer=layer):
            with uninterrupted():
                variants.activate()
                show_as_rendered(scene, layer)
                depsgraph = bpy.context.evaluated_depsgraph_get()
            exported = export_scene(depsgraph, (width, height), camera, self._cache)
        notes = [note.to_dict() for note in exported.notes]
        return BuiltScene(exported.scene, exported.camera, notes + _script_notes())

    def _view_layer(self):
        """The view layer that was chosen, or the first one that is used for rendering."""
        layers = self.scene.view_layers
        if self._layer:
            return layers[self._layer]
        used = [layer for layer in layers if layer.use]
        if not used:
            raise engine.InvalidInput(
                f"No view layer of the scene '{self.scene.name}' is used for rendering. Turn on Use for Rendering of "
                "one, or choose one with --view-layer."
            )
        return used[0]


def _script_notes():
    """Note on Python of the file that was not run."""
    import bpy

    if not bpy.app.autoexec_fail:
        return []
    effect = "not run, so what it would move stands still: add --run-scripts if you trust the file"
    return [
        {
            "object": bpy.app.autoexec_fail_message or "file",
            "feature": "Python",
            "effect": effect,
            "material": "",
        }
    ]


def _baked(blend):
    """Folders of baked simulations, which `bpy.utils.blend_paths` omits: Blender's own, and those of nodes."""
    import bpy

    default = blend.with_name(f"blendcache_{blend.stem}")
    if default.is_dir():
        yield default
    for thing in bpy.data.objects:
        for modifier in thing.modifiers:
            if isinstance(modifier, bpy.types.NodesModifier) and modifier.bake_directory:
                yield Path(bpy.path.abspath(modifier.bake_directory, library=thing.library))


def _sequences():
    """Paths that represent one numbered file per frame."""
    import bpy

    things = [
        *(image for image in bpy.data.images if image.source == "SEQUENCE"),
        *(
            thing
            for things in (bpy.data.volumes, bpy.data.cache_files)
            for thing in things
            if thing.is_sequence
        ),
    ]
    return {Path(bpy.path.abspath(thing.filepath, library=thing.library)) for thing in things}


def _files_at(path, sequence):
    """Files that a path of a .blend represents."""
    if path.is_dir():
        return [file for file in path.rglob("*") if file.is_file()]
    pattern = glob.escape(path.name)
    pattern = re.sub(
        r"<UDIM>|<UVTILE>", "*", re.sub(r"\d+(?=\D*$)", "[0-9]*", pattern) if sequence else pattern
    )
    return [path] if pattern == glob.escape(path.name) else [*path.parent.glob(pattern)] or [path]


class MitsubaSource:
    """A Mitsuba scene file, seen from its first sensor or from a chosen one.

    Parameters
    ----------
    path : Path
    define : dict of str to str, optional
        Values of the file's `$parameters`.
    strict : bool
        Whether to refuse values of parameters that the file lacks.
    """

    frame = None

    def __init__(self, path, define=None, strict=True):
        self.path, self.define, self._strict = path, define or {}, strict
        self._file = None

    def hologram_from(self, camera=None):
        """Hologram with the size of the image that Mitsuba renders.

        Parameters
        ----------
        camera : str, optional
            Id of a sensor. Default: the first one.

        Returns
        -------
        engine.Hologram

        Raises
        ------
        engine.InvalidInput
        """
        width, height = self._read().film(camera).size
        return engine.Hologram(width, height, 8e-6)

    @property
    def settings(self):
        """`engine.Settings` with the integrator's maximum path depth."""
        return engine.Settings(max_depth=self._read().max_depth)

    @property
    def files(self):
        """Paths of the files that the scene's text names, by their names relative to its folder."""
        files, texts = {self.path.name: self.path}, [self.path]
        values = dict(self.define)
        while texts:
            text = texts.pop().read_text("utf-8", "replace")
            for name, value in re.findall(r"""<default\s+name=["'](\w+)["']\s+value=["']([^"']*)""", text):
                values.setdefault(name, value)
            for name in sorted(values, key=len, reverse=True):
                text = text.replace(f"${name}", values[name])
            for name in re.findall(r"""["']([^"'<>|]+)["']""", text):
                file = self.path.parent / name
                if name not in files and file.is_file():
                    files[name] = file
                    texts += [file] if file.suffix.lower() == ".xml" else []
        return files

    def size_origin(self, camera=None):
        """Origin of the size of `hologram_from`, in words.

        Parameters
        ----------
        camera : str, optional
            See `hologram_from`.

        Returns
        -------
        str
        """
        film = self._read().film(camera)
        name = "crop window of the film" if film.is_cropped else "film" if film.has_size else "default film"
        return f"the {name} in {self.path.name}" if film.has_size else f"Mitsuba's {name}"

    def load(self, width, height, camera=None):
        """Build the scene.

        Parameters
        ----------
        width, height : int
            Pixels of the image.
        camera : str, optional
            See `hologram_from`.

        Returns
        -------
        BuiltScene

        Raises
        ------
        engine.InvalidInput, engine.BackendUnavailable
        """
        return self._read().build((width, height), camera)

    def _read(self):
        if self._file is None:
            with uninterrupted():
                variants.activate()
            self._file = MitsubaFile(self.path, self.define, self._strict)
        return self._file


class CaptureSource:
    """An image with depth, a point cloud, or views.

    Parameters
    ----------
    path : Path
    options : CaptureOptions

    Raises
    ------
    engine.InvalidInput
        If the options do not fit the file.
    """

    frame = None

    def __init__(self, path, options):
        self._file = captures.open_capture(path, options)
        self.path, self.files = path, self._file.files
        settings = engine.Settings(max_depth=1)  # it emits light, and reflects none
        views = isinstance(self._file, captures.ViewFile)
        self.settings = replace(settings, method=VIEW_METHODS[0]) if views else settings

    def hologram_from(self, camera=None):
        """Hologram with the size of the image or of a view, or of the default size for points.

        Parameters
        ----------
        camera : str, optional
            Has no effect.

        Returns
        -------
        engine.Hologram
        """
        return engine.Hologram(*self._file.size, 8e-6)

    def size_origin(self, camera=None):
        """Origin of the size of `hologram_from`, in words.

        Parameters
        ----------
        camera : str, optional
            Has no effect.

        Returns
        -------
        str
        """
        return self._file.size_from

    def load(self, width, height, camera=None):
        """Build the scene.

        Parameters
        ----------
        width, height : int
            Pixels of the image.
        camera : str, optional
            Viewpoint of points.

        Returns
        -------
        BuiltScene

        Raises
        ------
        engine.InvalidInput, engine.BackendUnavailable
        """
        return self._file.build((width, height), camera)


def open_requested(args):
    """Open the requested scene.

    Parameters
    ----------
    args : argparse.Namespace
        With `scene`, `scene_name`, `view_layer`, `run_scripts`, `define` and the options of captures.

    Returns
    -------
    BlenderSource, MitsubaSource or CaptureSource

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
        See `open_source`.
    """
    names = args.scene_name, args.view_layer
    if not is_blender_scene(args.scene) and (any(names) or args.run_scripts):
        raise engine.InvalidInput(
            f"Expected a .blend, got {args.scene}. Omit --scene-name, --view-layer and --run-scripts."
        )
    source = open_source(args.scene, args.run_scripts, dict(args.define or ()), options=capture_options(args))
    if isinstance(source, BlenderSource):
        source.choose(*names)
    return source


def is_blender_scene(text):
    """Whether a name is that of a Blender scene.

    Parameters
    ----------
    text : str
        See `open_source`.

    Returns
    -------
    bool
    """
    return text.startswith("demo:") or Path(text).suffix.lower() not in (".xml", *captures.SUFFIXES)


def capture_options(args):
    """Options of an image, a .ply or views.

    Parameters
    ----------
    args : argparse.Namespace

    Returns
    -------
    CaptureOptions
    """
    return CaptureOptions(
        args.depth,
        args.depth_unit,
        args.depth_ends and tuple(args.depth_ends),
        args.depth_along,
        args.fov,
        args.axes,
        args.point_radius,
        args.view_span and tuple(args.view_span),
        args.view_focus,
        args.view_panel,
    )


def open_source(text, run_scripts=False, define=None, strict=True, options=None):
    """Open a scene by the name that the command line calls SCENE.

    Parameters
    ----------
    text : str
        Path of a .blend, a Mitsuba .xml, an image, a .ply, an .npy or .npz of views, or ``demo:NAME``.
    run_scripts : bool
        Whether a .blend may run its Python.
    define : dict of str to str, optional
        Values of a Mitsuba file's `$parameters`.
    strict : bool
        Whether to refuse values of parameters that the file lacks.
    options : CaptureOptions, optional
        Options of an image, a .ply or views.

    Returns
    -------
    BlenderSource, MitsubaSource or CaptureSource

    Raises
    ------
    engine.InvalidInput
        If there is no such scene, or it cannot be opened.
    engine.BackendUnavailable
        If it needs bpy, which is missing.
    """
    check(text)
    if define and not text.lower().endswith(".xml"):
        raise engine.InvalidInput(f"{text} has no parameters to define. Omit --define.")
    options, path = options or CaptureOptions(), Path(text)
    if not text.startswith("demo:") and path.suffix.lower() in captures.SUFFIXES:
        return CaptureSource(path, options)
    if options.names:
        flag = options.names[0].replace("_", "-")
        raise engine.InvalidInput(
            f"Expected an image, a .ply, or an .npy or .npz of views for --{flag}, got {text}. Omit it."
        )
    if text.startswith("demo:"):
        _bpy("A demo scene")
        with native_output_to_stderr():
            demo.build(text.removeprefix("demo:"))
        return BlenderSource()
    if path.suffix.lower() == ".xml":
        return MitsubaSource(path, define, strict)
    bpy = _bpy("A .blend file")
    with native_output_to_stderr():
        try:
            bpy.ops.wm.open_mainfile(filepath=str(path.absolute()), load_ui=False, use_scripts=run_scripts)
        except RuntimeError as error:
            reason = " ".join(str(error).split()).removeprefix("Error: ")
            raise engine.InvalidInput(f"{text} cannot be opened by this Blender: {reason}") from error
    return BlenderSource()


def check(text):
    """Check that a scene exists, without opening it.

    Parameters
    ----------
    text : str
        See `open_source`.

    Raises
    ------
    engine.InvalidInput
        If there is no such file or demo, or it is not a scene by its suffix.
    """
    if text.startswith("demo:"):
        name = text.removeprefix("demo:")
        if name not in demo.DEMOS:
            raise engine.InvalidInput(f"There is no demo '{name}'. Choose one of {', '.join(demo.DEMOS)}.")
        return
    path = Path(text)
    if not path.is_file():
        raise engine.InvalidInput(
            f"The scene {text} does not exist. Give a .blend, a Mitsuba .xml, an image, a .ply, an .npy or .npz of "
            "views, or demo:NAME."
        )
    if path.suffix.lower() not in (".blend", ".xml", *captures.SUFFIXES):
        raise engine.InvalidInput(
            f"Expected a .blend, a Mitsuba .xml, an image ({', '.join(captures.PICTURES)}), a .ply, or an .npy or .npz "
            f"of views, got the scene {text}."
        )


def _bpy(kind):
    """Import bpy, with HoloPath's scene settings registered."""
    try:
        with uninterrupted():
            import bpy
    except ImportError as error:
        raise engine.BackendUnavailable(
            f"{kind} needs Blender, and this Python has no bpy ({error}). Run `pip install bpy`, or give the same "
            "options to `blender --command holopath`."
        ) from error
    if not bpy.app.background:
        raise engine.InvalidInput(
            f"{kind} would take the place of what is open in this window, unsaved. Start Blender with --background."
        )
    if not hasattr(bpy.types.Scene, "holopath"):
        from ..blender import properties

        properties.register()
    return bpy


@contextlib.contextmanager
def native_output_to_stderr():
    """Redirect the standard output of Blender's C code to standard error within the block."""
    sys.stdout.flush()
    saved = os.dup(1)
    try:
        os.dup2(2, 1)
        yield
    finally:
        sys.stdout.flush()
        os.dup2(saved, 1)
        os.close(saved)


@dataclass(frozen=True)
class Reopened:
    """The scene of a stored field.

    Attributes
    ----------
    name : str
        Name by which it was opened.
    scene : mitsuba.Scene
    settings : engine.Settings or None
        Settings of the field; None if its report lacks them.
    max_depth : int
        `Settings.max_depth` of the field's light; that of the scene if the report lacks it.
    same : bool
        Whether the scene is unchanged since the render.
    """

    name: str
    scene: "mi.Scene"
    settings: engine.Settings | None
    max_depth: int
    same: bool


def scene_name(report):
    """Name of a report's scene that can be opened from the current folder.

    Parameters
    ----------
    report : dict
        See `output.read_report`.

    Returns
    -------
    str or None
        None if the report names no scene.
    """
    name, path = report.get("scene"), report.get("scene_path")
    return path if path and name and not Path(name).exists() and Path(path).exists() else name


def reopen(folder, field, name=None, at_frame=None, run_scripts=False, define=None) -> Reopened:
    """Open the scene of a stored field.

    Parameters
    ----------
    folder : path
        Output folder.
    field : engine.WaveField
        Its field.
    name : str, optional
        Name of the scene. Default: that in the folder's report.
    at_frame : int, optional
        Frame of a Blender scene. Default: the field's.
    run_scripts : bool
        Whether a .blend may run its Python.
    define : dict of str to str, optional
        Values of a Mitsuba file's `$parameters`. Default: the field's, if the file has these parameters.

    Returns
    -------
    Reopened

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
        If there is no scene, or it cannot be opened.
    """
    report = output.read_report(folder)
    scene_state = report.get("scene_state") or {}  # missing in reports of versions before 0.3
    name = name or scene_name(report)
    if not name:
        raise engine.InvalidInput(f"The report in {folder} does not name a scene. Give it with --scene.")
    settings = _settings(folder, report)
    if define:
        source = open_source(name, run_scripts, define)
    elif not is_blender_scene(name) and not name.lower().endswith(".xml"):
        options = CaptureOptions.from_dict(scene_state.get("capture") or {})
        source = open_source(name, options=captures.with_depth_beside(options, Path(name)))
    else:
        stored = scene_state.get("define") if name.lower().endswith(".xml") else None
        source = open_source(name, run_scripts, stored, strict=False)
    if isinstance(source, BlenderSource):
        with contextlib.suppress(engine.InvalidInput):  # another file may have other names
            source.choose(scene_state.get("scene"), scene_state.get("view_layer"))
        if at_frame is None:
            at_frame = scene_state.get("frame")
    to_frame(at_frame, name, source)
    variants.activate()
    from ..engine.scene.fingerprint import scene_digest

    def load(camera):
        with native_output_to_stderr():
            picture = field.hologram.picture
            return source.load(picture.width, picture.height, camera).scene

    def same(scene):
        return scene_digest(scene) == report.get("scene_digest")

    try:
        scene = load(scene_state.get("camera"))  # the export depends on the camera a little
    except engine.InvalidInput:
        if not scene_state.get("camera"):
            raise
        scene = load(None)  # another scene may have other cameras
    if not same(scene) and isinstance(source, BlenderSource):
        scene = load(field.camera)
    max_depth = resolved(settings or source.settings).max_depth
    return Reopened(name, scene, settings, max_depth, same(scene))


def to_frame(frame, name, source):
    """Set the current frame of a Blender scene.

    Parameters
    ----------
    frame : int or None
        None to leave it.
    name : str
        Name of the scene, for the message.
    source : BlenderSource, MitsubaSource or CaptureSource

    Raises
    ------
    engine.InvalidInput
        If the scene is not Blender's.
    """
    if frame is None:
        return
    if not isinstance(source, BlenderSource):
        raise engine.InvalidInput(f"{name} has no frames. Omit --at-frame.")
    source.go_to(frame)


def _settings(folder, report):
    if "settings" not in report:
        return None
    try:
        return engine.Settings(**report["settings"])
    except TypeError:
        raise engine.InvalidInput(
            f"{folder} was rendered with settings that this version does not know. Render it again."
        ) from None
