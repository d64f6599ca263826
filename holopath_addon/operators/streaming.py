"""Operators of devices: show the hologram, move the camera's focus and take pictures."""

import math
import tempfile
from pathlib import Path

import bpy
from bpy.props import StringProperty

from .. import engine, slm
from ..blender import device_properties, properties
from ..workflow import failures
from . import devices, session
from .long_modal import LongModal, is_paused
from .modal_operator import ModalOperator, check_poll, has_phase, report_error

POLL_INTERVAL = 0.1  # seconds
NUMBER_SECONDS = 5.0  # seconds for which monitors show their numbers
SCRIPT_PATIENCE = 30.0  # seconds for which scripts wait for a lost device; in a window until it is stopped


class HOLOPATH_OT_stream(LongModal, bpy.types.Operator):
    """Show the encoded hologram on the device until it is stopped, or for the number of loops"""

    bl_idname = "holopath.stream"
    bl_label = "Stream to Device"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        if is_paused(cls):  # it shows a hologram that another one may have replaced
            return context.scene is not None
        idle = has_phase(cls) and check_poll(
            cls, not devices.streaming(), "A device shows a hologram: stop it first"
        )
        return idle and context.scene is not None

    def _prepare(self, context: bpy.types.Context, endless):
        """Prepare the stream; `endless`: whether 0 loops mean no end, rather than one loop."""
        device = properties.of(context.scene).device
        sequence = device_properties.sequence_of(device, session.current.phase)
        for note in sequence.notes:
            self.report({"WARNING"}, note)
        driver, trigger = device_properties.driver_of(device, sequence), None
        port = device.port, device.baud
        if device.driver == "serial":
            devices.release()  # a port can be opened once
            devices.current.port = port
        if device_properties.has_trigger(device):
            controller = getattr(driver, "controller", None) or devices.controller(*port)
            pulse = device.pulse

            def trigger(number):
                controller.trigger(number, pulse)

        loops = 1 if device.driver in ("files", "virtual") else device.loops or (None if endless else 1)
        rate = device.rate if device.driver != "files" else 0.0
        return devices.stream(
            driver, sequence, rate or None, loops, trigger, math.inf if endless else SCRIPT_PATIENCE
        )

    def execute(self, context: bpy.types.Context):
        """Show it and wait for the end; once if no number of loops is set."""
        try:
            job = self._prepare(context, endless=False)
            job.run()
        except Exception as error:
            return report_error(self, session.record_error(error, devices.current))
        return self._finish(job)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Show it in a thread; the window stays usable."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        if self.resume():
            return self.become_modal()
        try:
            job = self._prepare(context, endless=True)
            job.start()
        except Exception as error:
            return report_error(self, session.record_error(error, devices.current))
        self._job, self._lost = job, ""
        devices.current.timer = bpy.data.window_managers[0].event_timer_add(
            POLL_INTERVAL, window=context.window
        )
        session.redraw(images=False)
        return self.become_modal()

    def modal(self, context: bpy.types.Context, event: bpy.types.Event):
        """Poll the thread; Esc stops it, unless it cancels a render."""
        if devices.current.job is not self._job or devices.current.timer is None:
            return {"FINISHED", "PASS_THROUGH"}
        if event.type == "ESC" and event.value == "PRESS" and not session.running():
            devices.stop()
            return {"RUNNING_MODAL"}
        if event.type == "TIMER":
            if self._job.running and self.make_way():
                return {"FINISHED", "PASS_THROUGH"}
            if not self._job.running:
                devices.end_watching()
                return self._finish(self._job)
            counts = devices.current.counts
            lost = counts.lost if counts is not None else ""
            if lost and lost != self._lost:
                self.report({"WARNING"}, f"{lost} HoloPath waits for it.")
            elif self._lost and not lost:
                self.report({"INFO"}, "The device is connected again: streaming continues.")
            self._lost = lost
            session.redraw(images=False)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context):
        """End the operator for Blender: the window closes or another file is opened."""
        devices.stop()
        devices.end_watching()

    def _finish(self, job):
        counts = devices.current.counts
        session.redraw()
        if job.error is not None and not failures.cancelled(job.error):
            return report_error(self, session.record_error(job.error, devices.current))
        self.report(
            {"INFO"}, f"{'Stopped' if job.error else 'Done'}: {job.result or counts or 'nothing was shown'}."
        )
        return {"FINISHED"}


class HOLOPATH_OT_stop_streaming(bpy.types.Operator):
    """Stop showing the hologram on the device"""

    bl_idname = "holopath.stop_streaming"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return devices.streaming()

    def execute(self, context: bpy.types.Context):
        devices.stop()
        return {"FINISHED"}


class HOLOPATH_OT_find_devices(ModalOperator, bpy.types.Operator):
    """Look for monitors and serial ports, which their fields then suggest"""

    bl_idname = "holopath.find_devices"
    bl_label = "Find Devices"
    activity = "looking for devices"

    def work(self, scene):
        def look(job, progress):
            progress(0.1, "Looking for devices")
            try:
                monitors = [f"{m.name} {m.geometry}" for m in slm.monitors()]
            except engine.InvalidInput:
                monitors = []
            return {"monitors": monitors, "ports": [name for name, _ in slm.serial_ports()]}

        return look

    def finish(self, context: bpy.types.Context, result):
        device_properties.found_devices.update(result)
        monitors, ports = len(result["monitors"]), len(result["ports"])
        return f"{monitors} monitor{'' if monitors == 1 else 's'}, {ports} serial port{'' if ports == 1 else 's'} found"


class HOLOPATH_OT_identify_monitors(ModalOperator, bpy.types.Operator):
    """Show each monitor's number in the list on it for some seconds, to find the SLM"""

    bl_idname = "holopath.identify_monitors"
    bl_label = "Identify Monitors"
    activity = "showing numbers"

    @classmethod
    def poll(cls, context: bpy.types.Context):
        idle = check_poll(
            cls,
            not devices.streaming(),
            "A device shows a hologram, which numbers would cover: stop it first",
        )
        return idle and super().poll(context)

    def work(self, scene):
        def show(job, progress):
            found = slm.monitors()

            def on_progress(seconds_left):
                progress(1 - seconds_left / NUMBER_SECONDS, "A number is on each monitor")

            slm.identify(found, NUMBER_SECONDS, on_progress)
            return [f"{m.name} {m.geometry}" for m in found]

        return show

    def finish(self, context: bpy.types.Context, result):
        device_properties.found_devices["monitors"] = result
        return ", ".join(f"{number}: {monitor}" for number, monitor in enumerate(result, 1))


class HOLOPATH_OT_focus_plane(ModalOperator, bpy.types.Operator):
    """Move the camera's focus to the plane"""

    bl_idname = "holopath.focus_plane"
    bl_label = "Focus Camera"
    activity = "focusing"

    def work(self, scene):
        device = properties.of(bpy.data.scenes[scene]).device
        planes = device_properties.planes_of(device, _phase())
        move, number = _mover(device, planes), device.plane

        def focus(job, progress):
            move(number, lambda where: progress(0.5, f"Focusing: {where}"))
            return number, planes.planes[number].distance

        return focus

    def finish(self, context: bpy.types.Context, result):
        return f"Camera at plane {result[0]}, {result[1] * 1e3:g} mm,"


class HOLOPATH_OT_store_plane(ModalOperator, bpy.types.Operator):
    """Store the focus motor's current position for this plane"""

    bl_idname = "holopath.store_plane"
    bl_label = "Store Position"
    activity = "asking the motor"

    def work(self, scene):
        device = properties.of(bpy.data.scenes[scene]).device
        if not device.planes:
            raise engine.InvalidInput("There are no focus planes: choose their file, or make one with New.")
        path, number, port = bpy.path.abspath(device.planes), device.plane, (device.port, device.baud)
        planes = slm.FocusPlanes.load(path)
        planes.with_position(number, 0)  # raises if there is no such plane

        def store(job, progress):
            position = devices.controller(*port).resting_position()
            planes.with_position(number, position).save(path)
            return number, position

        return store

    def finish(self, context: bpy.types.Context, result):
        return f"Plane {result[0]} is position {result[1]}, stored"


class HOLOPATH_OT_new_planes(bpy.types.Operator):
    """Write a file of five focus planes, 80 to 85 mm from the SLM, without positions yet"""

    bl_idname = "holopath.new_planes"
    bl_label = "New"
    bl_options = {"UNDO"}

    filepath: StringProperty(name="File", description="JSON file to write", subtype="FILE_PATH")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        self.filepath = self.filepath or "focus_planes.json"
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context):
        path = Path(bpy.path.abspath(self.filepath)).with_suffix(".json")
        try:
            if path.exists():
                raise engine.InvalidInput(
                    f"{path} exists: choose another name, so that no calibration is lost."
                )
            slm.FocusPlanes.spread().save(path)
        except Exception as error:
            return report_error(self, session.record_error(error, devices.current))
        properties.of(context.scene).device.planes = str(path)
        self.report({"INFO"}, f"Five focus planes are in {path}.")
        return {"FINISHED"}


class HOLOPATH_OT_capture(ModalOperator, bpy.types.Operator):
    """Take a picture at the plane, with the camera's command or the virtual bench's camera"""

    bl_idname = "holopath.capture"
    bl_label = "Capture"
    activity = "taking a picture"

    def work(self, scene):
        device = properties.of(bpy.data.scenes[scene]).device
        planes, number = device_properties.planes_of(device, _phase()), device.plane
        planes.with_position(number, 0)  # raises if there is no such plane
        distance = planes.planes[number].distance
        if device.driver == "virtual":
            bench = _bench()

            def capture(job, progress):
                progress(0.1, "Taking a picture")
                bench.focus_at(distance)
                return distance, bench.capture()

            return capture
        if not device.camera:
            raise engine.InvalidInput("There is no camera: give the command that takes a picture.")
        command = device.camera

        def run(job, progress):
            progress(0.1, "Taking a picture")
            folder = tempfile.TemporaryDirectory(prefix="holopath-")
            slm.run_camera(command, Path(folder.name) / "picture.png", number, distance)
            return distance, folder

        return run

    def finish(self, context: bpy.types.Context, result):
        distance, picture = result
        if isinstance(picture, tempfile.TemporaryDirectory):
            with picture as folder:
                image = devices.load(Path(folder) / "picture.png")
        else:
            phase = _phase()
            assert phase is not None  # the bench shows it
            image = session.write_image(devices.CAMERA, session.to_rgba(picture, phase.hologram.wavelengths))
        self.present(context, image)
        return f"Picture for {distance * 1e3:g} mm taken"


def _phase():
    """Hologram on the device, or else the encoded one."""
    return devices.current.phase or session.current.phase


def _bench():
    """The virtual bench of the last stream."""
    bench = devices.current.driver
    if not isinstance(bench, slm.VirtualDriver):
        raise engine.InvalidInput("The virtual bench shows nothing yet: press Stream to Device.")
    return bench


def _mover(device, planes):
    """Function ``move(number, progress)`` that moves the camera's focus to a plane."""
    if device.driver == "virtual":
        bench = _bench()
        planes.with_position(device.plane, 0)  # raises if there is no such plane
        return lambda number, progress: bench.focus_at(planes.planes[number].distance)
    planes.position(device.plane)
    port = device.port, device.baud
    return lambda number, progress: devices.controller(*port).focus(planes.position(number), progress)


CLASSES = (
    HOLOPATH_OT_stream,
    HOLOPATH_OT_stop_streaming,
    HOLOPATH_OT_find_devices,
    HOLOPATH_OT_identify_monitors,
    HOLOPATH_OT_focus_plane,
    HOLOPATH_OT_store_plane,
    HOLOPATH_OT_new_planes,
    HOLOPATH_OT_capture,
)
