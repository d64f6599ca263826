"""Animations that another process renders while the window stays usable.

The process works on a copy of the file as it was at the start. Each frame is a folder that is written as a whole, and
finished frames are skipped, so the process may end at any time. It ends when its standard input ends, at the latest
with this Blender.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from .. import engine
from ..blender import preferences, properties
from ..blender.properties.optics import files_of, optics_of
from ..engine.displays import ENOUGH_BITS
from ..farm.job import job_of
from ..workflow import failures
from . import session
from .modal_operator import push_undo

REDRAW_INTERVAL = 0.5  # seconds
UNTITLED = "untitled.blend"  # name of a file that was never saved
MIN_FRAME_FRACTION = 0.2  # fraction of a frame from which the remaining time is estimated
_NOTE = re.compile(r"(?:frame_\d+: )?note: (.*)")
_ACTIVITY = re.compile(r"(Light|Frame -?\d+): (.*)")


@dataclass
class Background:
    """The running animation, or the last one.

    Attributes
    ----------
    file : str
        Name of its .blend.
    scene : str
        Name of its scene.
    count : int
        Number of its frames.
    done : float
        Progress, 0 to 1; frames that existed before count.
    message : str
        Current activity.
    lighting : bool
        Whether that is the light of all frames, before the first one.
    notes : list of str
        Notes on the results.
    error : str
        Failure in one sentence; empty without one.
    canceled : bool
    ended : bool
    """

    file: str = ""
    scene: str = ""
    count: int = 0
    done: float = 0.0
    message: str = ""
    lighting: bool = False
    notes: list = field(default_factory=list)
    error: str = ""
    canceled: bool = False
    ended: bool = True
    _process: subprocess.Popen | None = None
    _thread: threading.Thread | None = None
    _first_report: tuple | None = None  # time of the first report of a new frame, and its progress
    _end_time: float | None = None  # estimated

    @property
    def frame(self):
        """Number of the current frame, from 1 on."""
        return min(self.finished + 1, self.count)

    @property
    def finished(self):
        """Number of finished frames."""
        return int(self.done * self.count + 1e-6)

    @property
    def remaining(self):
        """Estimated seconds left; None at the start, when there is too little to estimate from."""
        return None if self._end_time is None else max(0.0, self._end_time - time.monotonic())

    def start(self, command, environment, folder, clear):
        """Start the process.

        Parameters
        ----------
        command : list of str
        environment : dict of str to str
        folder : Path
            Working directory.
        clear : callable
            Called without arguments after the end.
        """
        self._process = subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,  # Ctrl-C in a terminal goes to Blender
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # on Windows only
        )
        self.ended = False
        self._thread = threading.Thread(target=self._follow, args=(clear,), name="HoloPath", daemon=True)
        self._thread.start()

    def cancel(self):
        """End the process soon; finished frames stay."""
        if not self.ended and not self.canceled:
            self.canceled = True
            assert self._process is not None and self._process.stdin is not None
            self._process.stdin.close()

    def wait(self, seconds=None):
        """Wait for the end, for at most some seconds if given; whether it has ended."""
        if self._thread is not None:
            self._thread.join(seconds)
        return self.ended

    def _follow(self, clear):
        process = self._process
        assert process is not None and process.stderr is not None
        try:
            for line in process.stderr:
                self._read_line(line.strip())
            status = process.wait()
            if status != failures.DONE and not self.canceled and not self.error:
                self.error = _death_message(status)
        finally:
            clear()
            self.ended = True

    def _read_line(self, line):
        """Read a line of standard error: a report of `cli.supervised`, a failure, or a message of Blender's."""
        if line.startswith("holopath: "):
            if not self.canceled:
                self.error = line.removeprefix("holopath: ")
            return
        try:
            report = json.loads(line) if line.startswith("{") else {}
        except ValueError:
            return
        note = _NOTE.fullmatch(report.get("say", ""))
        if note and note[1] not in self.notes:
            self.notes.append(note[1])
        if "skipped" in report.get("say", ""):  # it took no time
            self._first_report = None
        if {"done", "message"} <= report.keys():
            activity = _ACTIVITY.fullmatch(report["message"])
            self.done, self.message = report["done"], activity[2] if activity else report["message"]
            self.lighting = bool(activity and activity[1] == "Light")
            self._estimate()

    def _estimate(self):
        now = time.monotonic()
        if self._first_report is None or self.lighting:
            self._first_report = now, self.done
        start, done_before = self._first_report
        done_since = self.done - done_before
        self._end_time = (
            now + (now - start) * (1 - self.done) / done_since
            if done_since * self.count > MIN_FRAME_FRACTION
            else None
        )


current = Background()


def _death_message(status):
    """Message for a process that ended with a status and no message."""
    how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
    return (
        f"The background process {how}, perhaps for lack of memory: press Render Animation again to continue after the "
        "finished frames."
    )


def running():
    """Whether an animation is being rendered."""
    return not current.ended


def frames_of(scene):
    """Numbers of the frames of a `bpy.types.Scene`, as a range."""
    return range(scene.frame_start, scene.frame_end + 1, scene.frame_step)


def folder_of(scene):
    """Folder of an animation's frames.

    Parameters
    ----------
    scene : bpy.types.Scene

    Returns
    -------
    Path

    Raises
    ------
    engine.InvalidInput
        If no folder is set, or it is relative to a file that was never saved.
    """
    path = properties.of(scene).animation_folder
    if not path or (path.startswith("//") and not bpy.data.filepath):
        raise engine.InvalidInput(
            "The animation's wave fields have no folder: save the .blend, or choose a folder in the Output properties."
        )
    return Path(bpy.path.abspath(path)).absolute()


def start(scene, view_layer):
    """Start a process that renders the animation of a scene as it is now; `current` has its progress.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene of the window.
    view_layer : bpy.types.ViewLayer
        View layer of the window.

    Raises
    ------
    engine.InvalidInput
        If the folder, the bench or the command cannot be used.
    OSError
    """
    global current
    changed = bpy.data.is_dirty
    name = Path(bpy.data.filepath).name or UNTITLED
    current = Background(name, scene.name, len(frames_of(scene)), message="Starting Blender")
    try:
        folder = folder_of(scene)
        check_free(folder, name, scene.name)
        copy = _save_copy(folder, name)
        try:
            words = [*_words(properties.of(scene), copy, folder), *_opened(scene, view_layer)]
            current.start(*_command(words, bpy.app.binary_path), folder, lambda: _remove(copy))
        except BaseException:
            _remove(copy)
            raise
    except Exception as error:
        current.error = failures.sentence(error)
        raise
    finally:
        if changed and not bpy.app.background:
            bpy.app.timers.register(_mark_as_changed)
    if not bpy.app.background:
        bpy.app.timers.register(_watch, first_interval=REDRAW_INTERVAL, persistent=True)


def check_free(folder, file, scene):
    """Refuse a folder with the animation of another file or scene: its frames would be replaced.

    Parameters
    ----------
    folder : Path
    file, scene : str
        Names of the file and of the scene to render.

    Raises
    ------
    engine.InvalidInput
    """
    job = job_of(folder)
    if job is None or job.scene == UNTITLED:  # the file may have been saved since
        return
    other = job.words.get("scene_name") or scene
    if (job.scene, other) != (file, scene):
        whose = job.scene if job.scene != file else f"the scene '{other}'"
        raise engine.InvalidInput(
            f"{folder} holds the animation of {whose}, which would be replaced: choose another folder in the Output "
            "properties, or delete that one."
        )


def _opened(scene, view_layer):
    """Words for scene and view layer of the window, with Python if this Blender ran the file's."""
    words = [f"--scene-name={scene.name}", f"--view-layer={view_layer.name}"]
    return words if bpy.app.autoexec_fail else [*words, "--run-scripts"]


def _save_copy(folder, name):
    """Save a copy of the file into a hidden folder, with its baked simulations, which Blender expects beside it."""
    from ..cli.supervised import COPY_PREFIX  # it imports all commands

    folder.mkdir(parents=True, exist_ok=True)
    own = Path(tempfile.mkdtemp(prefix=COPY_PREFIX, dir=folder))
    copy = own / name
    baked = f"blendcache_{copy.stem}"
    try:
        options = {"copy": True, "relative_remap": True, "compress": False, "check_existing": False}
        bpy.ops.wm.save_as_mainfile(filepath=str(copy), **options)
        if not _is_whole(copy):
            raise RuntimeError("No space left")
        source = Path(bpy.data.filepath).with_name(baked) if bpy.data.filepath else None
        if source and source.is_dir():
            shutil.copytree(source, own / baked, copy_function=_link)
    except RuntimeError as error:
        _remove(copy)
        reason = " ".join(str(error).split()).removeprefix("Error: ").rstrip(".")
        raise engine.InvalidInput(
            f"A copy of the file cannot be saved in {folder} ({reason}): free space or choose another folder."
        ) from error
    except BaseException:
        _remove(copy)
        raise
    return copy


def _is_whole(copy):
    """Whether a .blend was written to its end: on a full disk Blender may report nothing."""
    with open(copy, "rb") as file:
        file.seek(-min(64, copy.stat().st_size), os.SEEK_END)
        return b"ENDB" in file.read()


def _link(source, target):
    try:
        os.link(source, target)
    except OSError:  # on another disk
        shutil.copy2(source, target)


def _remove(copy):
    shutil.rmtree(copy.parent, ignore_errors=True)
    with suppress(OSError):
        copy.parent.parent.rmdir()  # if it is empty


def _words(props, copy, folder):
    """Words of the command: the scene, and the focus and pupil, which it does not read from the file."""
    words = ["render", str(copy), "--animation", "--attended", "--out", str(folder)]
    focus = properties.focus_list_of(props) if len(props.focus_list) else []
    if not props.focus_auto:
        focus = list(dict.fromkeys([properties.focus_of(props), *focus]))
    if focus:
        words += ["--focus", ",".join(map(repr, focus))]
    pupil = properties.pupil_or_none(props)
    if pupil is not None:
        numbers = (pupil.x, pupil.y, pupil.diameter)
        words.append("--pupil=" + ",".join(repr(number * 1e3) for number in numbers))
    words += _measured_bench(props)
    if props.animation_encodes:
        words += _encoding(props)
    cluster = preferences.cluster()
    return [*words, "--cluster", cluster] if cluster else words


def _measured_bench(props):
    """Words for measured files of the bench: the copy of the .blend lies elsewhere than their relative paths start."""
    files = {
        role: Path(bpy.path.abspath(path)).absolute() for role, path in files_of(props.optics).items() if path
    }
    stop, words = files.pop("stop", None), []
    if stop:
        words += ["--stop", str(stop)]
        if props.optics.carrier != "stop":
            place = (
                "auto" if props.optics.carrier == "auto" else ",".join(map(repr, optics_of(props).carrier))
            )
            words.append(f"--carrier={place}")
    if "field" in files:
        words += ["--beam", str(files["field"])]
    elif files:
        words += ["--beam", ",".join(f"{role}={path}" for role, path in files.items())]
    return words


def _encoding(props):
    """Words for encoding phases like *Encode*."""
    words, seconds = ["--encode", props.encoding], properties.encode_seconds_of(props)
    if seconds is not None:
        words += ["--encode-seconds", repr(seconds)]
    eyebox = properties.eyebox_of(props)
    if eyebox is not None and props.encoding not in ("dpac", "sgd"):
        words += ["--eyebox", repr(eyebox)]
    if props.animation_in_turn and props.encoding != "dpac":
        words += ["--encode-start", "before"]
    if props.device.calibration:
        return [*words, "--response", str(Path(bpy.path.abspath(props.device.calibration)).absolute())]
    return words if props.bits >= ENOUGH_BITS else [*words, "--bits", str(props.bits)]


def _command(words, blender):
    """Command that runs words, and its environment: this Blender, or this Python if Blender is its module.

    A cluster's machines have Python without Blender, and its client must be the same.
    """
    environment = preferences.environment()
    if blender and "--cluster" in words:
        command = shutil.which("holopath")
        if command is None:
            raise engine.InvalidInput(
                "A cluster needs the command holopath, which was not found: install what its machines have (HoloPath "
                "and `pip install distributed`), and start Blender with it on the PATH."
            )
        return [command, *words], environment
    if not blender:
        package = Path(__file__).parents[1]
        places = str(package.parent), environment.get("PYTHONPATH")
        path = {"PYTHONPATH": os.pathsep.join(filter(None, places))}
        return [sys.executable, "-m", package.name, *words], environment | path
    enabled = "--addons", preferences.ADDON  # the preferences on disk may not list it yet
    return [blender, "--background", *enabled, "--command", "holopath", *words], environment


def _mark_as_changed():
    """Mark the file as changed again: saving the copy clears Blender's mark, some events later."""
    push_undo("Render Animation")


def _watch():
    """Redraw the panels while the process runs; as a timer."""
    active = running()
    session.redraw(images=False)
    return REDRAW_INTERVAL if active else None


def detach():
    """Stop the animation and forget it."""
    global current
    for timer in (_watch, _mark_as_changed):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    current.cancel()
    current = Background()
