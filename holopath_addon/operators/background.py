"""An animation that a process of its own renders, while the window stays free; what this Blender knows of it.

The process works on a copy of the file as it was when it was started. Frames are whole folders, and those that are done
are found again, so that it may end at any time: it is canceled when its standard input ends, with this Blender at last.
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
from ..farm.job import job_of
from ..workflow import failures
from . import session
from .hologram import ENOUGH_BITS
from .working import push_undo

REDRAW = 0.5  # seconds between two looks for news
UNTITLED = "untitled.blend"  # of a file that is not saved yet
ENOUGH = 0.2  # of a frame, after which the time of the others is told
_NOTE = re.compile(r"(?:frame_\d+: )?note: (.*)")
_MAKING = re.compile(r"(Light|Frame -?\d+): (.*)")


@dataclass
class Background:
    """An animation in work, or the last one.

    Attributes
    ----------
    file : str
        Name of the .blend that it is of.
    count : int
        Of its frames.
    done : float
        0..1, frames that were there before included.
    message : str
        What is being done.
    lighting : bool
        Whether that is for the light of all frames, before the first one.
    notes : list of str
        What is to be known of the results.
    error : str
        Why it failed, in one sentence; empty if it did not.
    canceled : bool
    ended : bool
    """

    file: str = ""
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
    _begun: tuple | None = None  # when the first frame was that was not there before, and how far all was
    _end: float | None = None  # when all will be done, as the frames so far tell

    @property
    def frame(self):
        """Which of the frames is in work, from 1 on."""
        return min(self.finished + 1, self.count)

    @property
    def finished(self):
        """How many frames are done."""
        return int(self.done * self.count + 1e-6)

    @property
    def remaining(self):
        """Seconds left, as the frames so far tell; None while that is too little."""
        return None if self._end is None else max(0.0, self._end - time.monotonic())

    def start(self, command, environment, folder, clear):
        """Have the process work in a folder; `clear()` is called after its end."""
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
            start_new_session=True,  # Ctrl-C in a terminal is for Blender
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # of Windows alone
        )
        self.ended = False
        self._thread = threading.Thread(target=self._follow, args=(clear,), name="HoloPath", daemon=True)
        self._thread.start()

    def cancel(self):
        """Have it stop soon; frames that are done stay."""
        if not self.ended and not self.canceled:
            self.canceled = True
            assert self._process is not None and self._process.stdin is not None
            self._process.stdin.close()

    def wait(self, seconds=None):
        """Wait for its end; True if it has ended."""
        if self._thread is not None:
            self._thread.join(seconds)
        return self.ended

    def _follow(self, clear):
        process = self._process
        assert process is not None and process.stderr is not None
        try:
            for line in process.stderr:
                self._hear(line.strip())
            status = process.wait()
            if status != failures.DONE and not self.canceled and not self.error:
                self.error = _died(status)
        finally:
            clear()
            self.ended = True

    def _hear(self, line):
        """A line of `cli.supervised`, the sentence of a failure, or what Blender prints."""
        if line.startswith("holopath: "):
            if not self.canceled:
                self.error = line.removeprefix("holopath: ")
            return
        try:
            told = json.loads(line) if line.startswith("{") else {}
        except ValueError:
            return
        note = _NOTE.fullmatch(told.get("say", ""))
        if note and note[1] not in self.notes:
            self.notes.append(note[1])
        if "skipped" in told.get("say", ""):  # it took no time
            self._begun = None
        if "done" in told:
            making = _MAKING.fullmatch(told["message"])
            self.done, self.message = told["done"], making[2] if making else told["message"]
            self.lighting = bool(making and making[1] == "Light")
            self._estimate()

    def _estimate(self):
        now = time.monotonic()
        if self._begun is None or self.lighting:
            self._begun = now, self.done
        began, there = self._begun
        made = self.done - there
        self._end = now + (now - began) * (1 - self.done) / made if made * self.count > ENOUGH else None


current = Background()


def _died(status):
    """Why a process ended that could not say so."""
    how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
    return (
        f"The background process {how}, perhaps for want of memory: press Render Animation again, and it goes on after "
        "the frames that are done."
    )


def running():
    """Whether an animation is being rendered."""
    return not current.ended


def frames_of(scene):
    """Numbers of the frames of an animation."""
    return range(scene.frame_start, scene.frame_end + 1, scene.frame_step)


def folder_of(scene):
    """Folder of an animation's frames.

    Raises
    ------
    engine.InvalidInput
        If there is none.
    """
    path = properties.of(scene).animation_folder
    if not path or (path.startswith("//") and not bpy.data.filepath):
        raise engine.InvalidInput(
            "The animation's wave fields have no folder: save the .blend, or choose a folder in the Output properties."
        )
    return Path(bpy.path.abspath(path)).absolute()


def start(scene, view_layer):
    """Have a process render the animation of a scene as it is now; how that goes is told by `current`.

    Parameters
    ----------
    scene : bpy.types.Scene
    view_layer : bpy.types.ViewLayer
        Those of the window.

    Raises
    ------
    engine.InvalidInput, OSError
    """
    global current
    changed = bpy.data.is_dirty
    name = Path(bpy.data.filepath).name or UNTITLED
    current = Background(name, len(frames_of(scene)), message="Starting Blender")
    try:
        folder = folder_of(scene)
        _check_free(folder, name, scene.name)
        copy = _copied(folder, name)
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
        bpy.app.timers.register(_watch, first_interval=REDRAW, persistent=True)


def _check_free(folder, file, scene):
    """Refuse a folder with the animation of another file or scene, whose frames would be replaced."""
    job = job_of(folder)
    if job is None or job.scene == UNTITLED:  # it may have been saved since
        return
    other = job.words.get("scene_name") or scene
    if (job.scene, other) != (file, scene):
        whose = job.scene if job.scene != file else f"the scene '{other}'"
        raise engine.InvalidInput(
            f"{folder} holds the animation of {whose}, which would be replaced: choose another folder in the Output "
            "properties, or delete that one."
        )


def _opened(scene, view_layer):
    """Words for what of the file is rendered: what the window shows, with Python where this Blender ran all of it."""
    words = [f"--scene-name={scene.name}", f"--view-layer={view_layer.name}"]
    return words if bpy.app.autoexec_fail else [*words, "--run-scripts"]


def _copied(folder, name):
    """The file as it is now, in a hidden folder with its baked simulations, which Blender looks for beside it."""
    from ..cli.supervised import COPY_PREFIX  # with all commands: not before one is wanted

    folder.mkdir(parents=True, exist_ok=True)
    own = Path(tempfile.mkdtemp(prefix=COPY_PREFIX, dir=folder))
    copy = own / name
    baked = f"blendcache_{copy.stem}"
    try:
        told = {"copy": True, "relative_remap": True, "compress": False, "check_existing": False}
        bpy.ops.wm.save_as_mainfile(filepath=str(copy), **told)
        if not _whole(copy):
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


def _whole(copy):
    """Whether a .blend was written to its end: where the disk is full Blender may say nothing."""
    with open(copy, "rb") as file:
        file.seek(-min(64, copy.stat().st_size), os.SEEK_END)
        return b"ENDB" in file.read()


def _link(source, target):
    try:
        os.link(source, target)
    except OSError:  # of another disk
        shutil.copy2(source, target)


def _remove(copy):
    shutil.rmtree(copy.parent, ignore_errors=True)
    with suppress(OSError):
        copy.parent.parent.rmdir()  # if nothing came of it


def _words(props, copy, folder):
    """Of the command: focus and pupil are looked through, and so no settings of the file for it."""
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
    """Words for what was measured of the bench: the copy of the .blend does not lie where its paths begin."""
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
    """Words for phases, as *Encode* makes them."""
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
    """What runs the words, and its environment: this Blender, or this Python where Blender is its module.

    Machines of a cluster have Python and no Blender, and want to be spoken with by the same.
    """
    environment = preferences.environment()
    if blender and "--cluster" in words:
        command = shutil.which("holopath")
        if command is None:
            raise engine.InvalidInput(
                "A cluster is spoken with by the command holopath, which is not found: install what its machines have "
                "(HoloPath and `pip install distributed`), and start Blender where that is on the PATH."
            )
        return [command, *words], environment
    if not blender:
        package = Path(__file__).parents[1]
        places = str(package.parent), environment.get("PYTHONPATH")
        path = {"PYTHONPATH": os.pathsep.join(filter(None, places))}
        return [sys.executable, "-m", package.name, *words], environment | path
    enabled = "--addons", preferences.ADDON  # which preferences on disk may not know yet
    return [blender, "--background", *enabled, "--command", "holopath", *words], environment


def _mark_as_changed():
    """Have Blender ask for unsaved changes as before: the copy that was saved clears its mark, some events later."""
    push_undo("Render Animation")


def _watch():
    """Redraw the panels while there may be news; as a timer."""
    going = running()
    session.redraw(images=False)
    return REDRAW if going else None


def detach():
    """Stop the work and forget it."""
    global current
    for timer in (_watch, _mark_as_changed):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    current.cancel()
    current = Background()
