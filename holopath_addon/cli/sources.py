"""Where a scene comes from: a .blend, a Mitsuba .xml, a demo, a picture with depth, a point cloud, or views; also that
of a stored field, opened again.

bpy is imported only where it is needed.
"""

import contextlib
import glob
import os
import re
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from .. import engine
from ..blender import demo
from ..engine.scene import variants
from ..engine.scene.captured.views import METHODS as VIEW_METHODS
from ..exchange import captures
from ..exchange.captures import CaptureOptions
from ..exchange.mitsuba_file import MitsubaFile
from ..farm.processes import uninterrupted
from ..workflow import output

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass(frozen=True)
class Loaded:
    """A scene ready to be rendered.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : engine.Camera
    notes : list of dict
        What the exporter or the scene file's reader approximated or left out: object, feature, effect, material,
        see `export.Note`.
    """

    scene: "mi.Scene"
    camera: engine.Camera
    notes: list = field(default_factory=list)


class BlenderSource:
    """The file that is open in bpy. Its HoloPath settings are the defaults.

    Attributes
    ----------
    scene : bpy.types.Scene
        The one in which the file was saved, or that was chosen.
    """

    def __init__(self):
        from ..export import ExportCache

        self._cache = ExportCache()  # frames of an animation differ little
        self._scene, self._layer = "", ""  # names, where they are chosen

    @property
    def scene(self):
        import bpy

        scene = bpy.data.scenes[self._scene] if self._scene else bpy.context.scene
        assert scene is not None  # every file has one
        return scene

    def choose(self, scene=None, view_layer=None):
        """Choose another scene or view layer of the file, by its name.

        Raises
        ------
        engine.InvalidInput
            If it has none of that name.
        """
        import bpy

        for name, there, kind, flag in (
            (scene, bpy.data.scenes, "scene", "--scene-name"),
            (
                view_layer,
                (bpy.data.scenes.get(scene or "") or self.scene).view_layers,
                "view layer",
                "--view-layer",
            ),
        ):
            if name and name not in there:
                others = ", ".join(f"'{each.name}'" for each in there)
                raise engine.InvalidInput(f"There is no {kind} '{name}': choose one of {others} with {flag}.")
        self._scene, self._layer = scene or self._scene, view_layer or ""

    def hologram_from(self, camera=None):
        """`engine.Hologram` of the settings in the current frame, whatever the camera."""
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
        """Paths of the files that the scene is made of, whether they are there or not, `pathlib.Path` by names.

        The names are the same on every machine: paths from the .blend's folder, or as the .blend has them from the
        root. Packed files are the .blend's own.
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
        found = {}
        for path, relative in paths:
            for file in _files_at(path, path in sequences):
                name = os.path.relpath(file, blend.parent) if relative else str(file)
                found[name.replace(os.sep, "/")] = file
        return found

    def go_to(self, frame):
        """Make a frame the current one."""
        # in a handler Blender would swallow an interrupt
        with native_output_to_stderr(), uninterrupted():
            self.scene.frame_set(frame)

    def load(self, width, height, camera=None):
        """Export the current frame for `width` x `height` pixels; `camera` is an object's name."""
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
        return Loaded(exported.scene, exported.camera, notes + _scripts_left_out())

    def _view_layer(self):
        """The view layer that was chosen, or the first one that renders use."""
        layers = self.scene.view_layers
        if self._layer:
            return layers[self._layer]
        used = [layer for layer in layers if layer.use]
        if not used:
            raise engine.InvalidInput(
                f"No view layer of the scene '{self.scene.name}' is used for rendering: turn on Use for Rendering of "
                "one, or name one with --view-layer."
            )
        return used[0]


def _scripts_left_out():
    """A note where the file has Python that was not run."""
    import bpy

    if not bpy.app.autoexec_fail:
        return []
    effect = "not run, so what it moves stands still: add --run-scripts, if you trust the file"
    return [
        {
            "object": bpy.app.autoexec_fail_message or "file",
            "feature": "Python",
            "effect": effect,
            "material": "",
        }
    ]


def _baked(blend):
    """Folders of baked simulations, which `bpy.utils.blend_paths` leaves out: Blender's own, and those of nodes."""
    import bpy

    default = blend.with_name(f"blendcache_{blend.stem}")
    if default.is_dir():
        yield default
    for thing in bpy.data.objects:
        for modifier in thing.modifiers:
            if isinstance(modifier, bpy.types.NodesModifier) and modifier.bake_directory:
                yield Path(bpy.path.abspath(modifier.bake_directory, library=thing.library))


def _sequences():
    """Paths that stand for a numbered file of each frame."""
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
    """The files that a path of a .blend stands for."""
    if path.is_dir():
        return [file for file in path.rglob("*") if file.is_file()]
    pattern = glob.escape(path.name)
    pattern = re.sub(
        r"<UDIM>|<UVTILE>", "*", re.sub(r"\d+(?=\D*$)", "[0-9]*", pattern) if sequence else pattern
    )
    return [path] if pattern == glob.escape(path.name) else [*path.parent.glob(pattern)] or [path]


class MitsubaSource:
    """A Mitsuba scene file; the viewer stands at its first sensor, or at the one that is named.

    Parameters
    ----------
    path : Path
    define : dict of str to str, optional
        Values of the file's `$parameters`.
    strict : bool
        Whether values of parameters that it does not have are refused.
    """

    frame = None

    def __init__(self, path, define=None, strict=True):
        self.path, self.define, self._strict = path, define or {}, strict
        self._file = None

    def hologram_from(self, camera=None):
        """`engine.Hologram` as large as the picture that Mitsuba renders; `camera` is a sensor's id."""
        width, height = self._read().film(camera).size
        return engine.Hologram(width, height, 8e-6)

    @property
    def settings(self):
        """`engine.Settings`, with paths as long as the integrator's."""
        return engine.Settings(max_depth=self._read().max_depth)

    @property
    def files(self):
        """Paths of the files that the scene is made of by their names from its folder: whatever its text names."""
        found, texts = {self.path.name: self.path}, [self.path]
        values = dict(self.define)
        while texts:
            text = texts.pop().read_text("utf-8", "replace")
            for name, value in re.findall(r"""<default\s+name=["'](\w+)["']\s+value=["']([^"']*)""", text):
                values.setdefault(name, value)
            for name in sorted(values, key=len, reverse=True):
                text = text.replace(f"${name}", values[name])
            for name in re.findall(r"""["']([^"'<>|]+)["']""", text):
                file = self.path.parent / name
                if name not in found and file.is_file():
                    found[name] = file
                    texts += [file] if file.suffix.lower() == ".xml" else []
        return found

    def size_from(self, camera=None):
        """Where the size of `hologram_from` is from, as words."""
        film = self._read().film(camera)
        what = "crop window of the film" if film.is_cropped else "film" if film.has_size else "default film"
        return f"the {what} in {self.path.name}" if film.has_size else f"Mitsuba's {what}"

    def load(self, width, height, camera=None):
        """Build the scene for `width` x `height` pixels; `camera` is a sensor's id."""
        built = self._read().build((width, height), camera)
        return Loaded(built.scene, built.camera, built.notes)

    def _read(self):
        if self._file is None:
            with uninterrupted():
                variants.activate()
            self._file = MitsubaFile(self.path, self.define, self._strict)
        return self._file


class CaptureSource:
    """A picture with depth, a point cloud, or views.

    Parameters
    ----------
    path : Path
    options : CaptureOptions
    """

    frame = None

    def __init__(self, path, options):
        self._file = captures.open_capture(path, options)
        self.path, self.files = path, self._file.files
        settings = engine.Settings(max_depth=1)  # it shines, and reflects nothing
        views = isinstance(self._file, captures.ViewFile)
        self.settings = replace(settings, method=VIEW_METHODS[0]) if views else settings

    def hologram_from(self, camera=None):
        """`engine.Hologram` as large as the picture, or a view; of points, of the usual size."""
        return engine.Hologram(*self._file.size, 8e-6)

    def size_from(self, camera=None):
        """Where the size of `hologram_from` is from, as words."""
        return self._file.size_from

    def load(self, width, height, camera=None):
        """Build the scene for `width` x `height` pixels; `camera` is where points are seen from."""
        built = self._file.build((width, height), camera)
        return Loaded(built.scene, built.camera, built.notes)


def asked(args):
    """Open the scene that words ask for.

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
        As of `open_source`.
    """
    names, blend = (args.scene_name, args.view_layer), of_blender(args.scene)
    if not blend and (any(names) or args.run_scripts):
        raise engine.InvalidInput(
            f"{args.scene} is no file of Blender's: leave out --scene-name, --view-layer and --run-scripts."
        )
    source = open_source(args.scene, args.run_scripts, dict(args.define or ()), options=capture_options(args))
    if isinstance(source, BlenderSource):
        source.choose(*names)
    return source


def of_blender(text):
    """Whether it is a scene of Blender's, by its name."""
    return text.startswith("demo:") or Path(text).suffix.lower() not in (".xml", *captures.SUFFIXES)


def capture_options(args):
    """The `CaptureOptions` that words ask for."""
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
    """Open what the command line calls SCENE.

    Parameters
    ----------
    text : str
        Path of a .blend, a Mitsuba .xml, a picture, a .ply, an .npy or .npz of views, or ``demo:NAME``.
    run_scripts : bool
        Whether a .blend may run its Python.
    define : dict of str to str, optional
        Values of a Mitsuba file's `$parameters`.
    strict : bool
        Whether values of parameters that it does not have are refused.
    options : CaptureOptions, optional
        Of a picture, a .ply or views.

    Returns
    -------
    BlenderSource, MitsubaSource or CaptureSource

    Raises
    ------
    engine.InvalidInput
        If there is no such scene or it cannot be opened.
    engine.BackendUnavailable
        If it needs bpy and there is none.
    """
    check(text)
    if define and not text.lower().endswith(".xml"):
        raise engine.InvalidInput(f"{text} has no parameters to define: leave out --define.")
    options, path = options or CaptureOptions(), Path(text)
    if not text.startswith("demo:") and path.suffix.lower() in captures.SUFFIXES:
        return CaptureSource(path, options)
    if options.names:
        flag = options.names[0].replace("_", "-")
        raise engine.InvalidInput(
            f"{text} is neither a picture nor a .ply, nor an .npy or .npz of views: leave out --{flag}."
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
    """Refuse what is no scene's name, or of no scene; nothing is opened.

    Raises
    ------
    engine.InvalidInput
    """
    if text.startswith("demo:"):
        name = text.removeprefix("demo:")
        if name not in demo.DEMOS:
            raise engine.InvalidInput(f"There is no demo '{name}': choose one of {', '.join(demo.DEMOS)}.")
        return
    path = Path(text)
    if not path.is_file():
        raise engine.InvalidInput(
            f"The scene {text} does not exist: give a .blend, a Mitsuba .xml, a picture, a .ply, an .npy or .npz of "
            "views, or demo:NAME."
        )
    if path.suffix.lower() not in (".blend", ".xml", *captures.SUFFIXES):
        raise engine.InvalidInput(
            f"The scene {text} is neither a .blend nor a Mitsuba .xml, nor a picture "
            f"({', '.join(captures.PICTURES)}), a .ply or an .npy or .npz of views."
        )


def _bpy(what):
    """The bpy module, with HoloPath's scene settings registered."""
    try:
        with uninterrupted():
            import bpy
    except ImportError as error:
        raise engine.BackendUnavailable(
            f"{what} needs Blender, and this Python has no bpy ({error}): install it with `pip install bpy`, "
            "or run the same words in `blender --command holopath`."
        ) from error
    if not hasattr(bpy.types.Scene, "holopath"):
        from ..blender import properties

        properties.register()
    return bpy


@contextlib.contextmanager
def native_output_to_stderr():
    """While Blender loads a file, what its C code prints goes to standard error, not into our output."""
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
    """A scene, and how it was rendered.

    Attributes
    ----------
    name : str
        By which it was opened.
    scene : mitsuba.Scene
    settings : engine.Settings or None
        Of the field; None if its folder does not know them.
    same : bool
        Whether it is what the field was rendered of.
    """

    name: str
    scene: "mi.Scene"
    settings: engine.Settings | None
    same: bool


def named(report):
    """The scene of an output folder's report as it can be opened from here; None if it names none."""
    name, path = report.get("scene"), report.get("scene_path")
    return path if path and name and not Path(name).exists() and Path(path).exists() else name


def reopen(folder, field, name=None, at_frame=None, run_scripts=False, define=None) -> Reopened:
    """Open the scene of a stored field.

    Parameters
    ----------
    folder : path
        Output folder.
    field : engine.WaveField
        That it stores.
    name : str, optional
        Default: what its report says.
    at_frame : int, optional
        Frame of a Blender scene. Default: that of the field.
    run_scripts : bool
        Whether a .blend may run its Python.
    define : dict of str to str, optional
        Values of a Mitsuba file's `$parameters`. Default: those of the field, where the file has them.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
        If there is none, or it cannot be opened.
    """
    report = output.read_report(folder)
    opened = report.get("opened") or {}  # versions before 0.3 do not tell
    name = name or named(report)
    if not name:
        raise engine.InvalidInput(f"{folder} does not say which scene it is of: name it with --scene.")
    settings = _settings(folder, report)
    if define:
        source = open_source(name, run_scripts, define)
    elif not of_blender(name) and not name.lower().endswith(".xml"):
        options = CaptureOptions.from_dict(opened.get("capture") or {})
        source = open_source(name, options=captures.with_depth_beside(options, Path(name)))
    else:
        kept = opened.get("define") if name.lower().endswith(".xml") else None
        source = open_source(name, run_scripts, kept, strict=False)
    if isinstance(source, BlenderSource):
        with contextlib.suppress(engine.InvalidInput):  # another file than the field's has others
            source.choose(opened.get("scene"), opened.get("view_layer"))
        if at_frame is None:
            at_frame = opened.get("frame")
    to_frame(at_frame, name, source)
    variants.activate()
    from ..engine.scene.fingerprint import scene_digest

    def loaded(camera):
        with native_output_to_stderr():
            picture = field.hologram.picture
            return source.load(picture.width, picture.height, camera).scene

    def same(scene):
        return scene_digest(scene) == report.get("scene_digest")

    try:
        scene = loaded(opened.get("camera"))  # what is exported depends on the camera a little
    except engine.InvalidInput:
        if not opened.get("camera"):
            raise
        scene = loaded(None)  # another scene than the field's may have another camera
    if not same(scene) and isinstance(source, BlenderSource):
        scene = loaded(field.camera)
    return Reopened(name, scene, settings, same(scene))


def to_frame(frame, name, source):
    """Make a frame the current one; None: as it is."""
    if frame is None:
        return
    if not isinstance(source, BlenderSource):
        raise engine.InvalidInput(f"{name} has no frames: leave out --at-frame.")
    source.go_to(frame)


def _settings(folder, report):
    if "settings" not in report:
        return None
    try:
        return engine.Settings(**report["settings"])
    except TypeError:
        raise engine.InvalidInput(
            f"{folder} was rendered with settings that this version does not know: render it again."
        ) from None
