"""MuJoCo's own window: a run as it happens, or a record, in a picture that is never simulated."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.viewers.live import Moment
from kr210_sim.viewers.pace import Pace

NO_DISPLAY = (
    "--viewer native: there is no display that MuJoCo can open a window on; give --viewer web, or "
    "set DISPLAY"
)

KEYS = "space: pause, right arrow: step a stage, + and -: speed"
SEEK_KEYS = "[ and ]: half a second back and on"

_SPACE, _RIGHT, _FASTER, _SLOWER = 32, 262, (61, 334), (45, 333)
_SEEK = {91: -0.5, 93: 0.5}
"""GLFW's codes of the keys, on the keypad, too, and how far [s] those go that seek."""

_FACTOR = 1.5
"""By which a key changes the speed."""

_PROBE = """
import glfw, sys
glfw.ERROR_REPORTING = False
if not glfw.init():
    sys.exit(1)
glfw.window_hint(glfw.VISIBLE, False)
sys.exit(0 if glfw.create_window(64, 64, "", None, None) else 1)
"""

_PROBE_SECONDS = 60.0


def check_display() -> None:
    """Make sure that a window can be opened; MuJoCo would wait for one forever.

    Raises:
        BadInput: if none can, with what to do.
    """
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE],
            capture_output=True,
            timeout=_PROBE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise BadInput(NO_DISPLAY) from error
    if probe.returncode != 0:
        raise BadInput(NO_DISPLAY)


class NativeScreen:
    """A window of MuJoCo's viewer; it shows a model of its own, so nothing done in it counts.

    Args:
        pace: what its keys change; it ends when the window is closed.
        seek: called with the time [s] that a key goes to, where that can be done.
    """

    def __init__(self, pace: Pace, seek: Callable[[float], None] | None = None) -> None:
        self._pace, self._seek = pace, seek
        self._time = 0.0
        self._window: Any = None
        self._model: mujoco.MjModel | None = None
        self._data: mujoco.MjData | None = None
        self._last = ""

    @property
    def open(self) -> bool:
        """Whether there is a window."""
        return self._window is not None and bool(self._window.is_running())

    def load(self, model: mujoco.MjModel, prefix: str) -> None:
        """Show another model in a window of its own, unless the window has been closed."""
        if self._window is not None and not self.open:
            return
        if self._model is not None and _same(self._model, model):
            return
        self.close()
        import mujoco.viewer

        self._model, self._data = model, mujoco.MjData(model)
        try:
            self._window = mujoco.viewer.launch_passive(
                model,
                self._data,
                key_callback=self._pressed,
                show_left_ui=False,
                show_right_ui=False,
            )
        except RuntimeError as error:  # on macOS, outside of mjpython
            raise BadInput(f"--viewer native: {' '.join(str(error).split())}") from error
        with self._window.lock():
            camera = self._window.cam
            if model.ncam:
                camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0

    def show(self, qpos: Array, moment: Moment) -> None:
        """Show qpos (nq,)."""
        if not self._still_open() or self._data is None:
            return
        with self._window.lock():
            self._data.qpos[:] = qpos
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_comPos(self._model, self._data)
            mujoco.mj_camlight(self._model, self._data)
        self._time = moment.time
        cycle = "" if moment.cycle is None else f"cycle {moment.cycle}\n"
        text = (
            f"{cycle}{moment.stage}\n{moment.time:.2f} s\n{self._pace.speed:.3g} x\n{moment.note}"
        )
        place = mujoco.mjtGridPos.mjGRID_TOPLEFT
        self._window.set_texts((mujoco.mjtFontScale.mjFONTSCALE_150, place, text, self._last))
        self._window.sync()

    def idle(self) -> None:
        """Let the window react while nothing moves."""
        if self._still_open():
            self._window.sync()

    def tell(self, line: dict[str, Any]) -> None:
        """Note a finished cycle, as `cycles.jsonl` has it."""
        verdict = "success" if line["success"] else line["reason"]
        self._last = f"cycle {line['cycle']}: {verdict}"

    def close(self) -> None:
        """Take the window away."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _still_open(self) -> bool:
        if self.open:
            return True
        self._pace.end()
        return False

    def _pressed(self, key: int) -> None:
        if key == _SPACE:
            self._pace.toggle()
        elif key == _RIGHT:
            self._pace.step_stage()
        elif key in _FASTER:
            self._pace.set_speed(self._pace.speed * _FACTOR)
        elif key in _SLOWER:
            self._pace.set_speed(self._pace.speed / _FACTOR)
        elif key in _SEEK and self._seek is not None:
            self._seek(self._time + _SEEK[key])


def _same(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Tell whether two models look alike, so that one can stand for the other."""
    return (
        one.nq == other.nq
        and one.ngeom == other.ngeom
        and np.array_equal(one.geom_size, other.geom_size)
        and np.array_equal(one.geom_dataid, other.geom_dataid)
        and np.array_equal(one.jnt_qposadr, other.jnt_qposadr)
        and np.array_equal(one.mesh_vert, other.mesh_vert)
    )
