"""The forward-kinematics page: sliders move the arm, and the page shows poses and branches."""

from __future__ import annotations

import threading
from typing import Any

import mujoco
import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.viewers.arm_state import ArmState, arm_state, nearest_solution
from kr210_sim.viewers.ghosts import COLORS, css, place_ghosts
from kr210_sim.viewers.page import Page, add_shadow_box, quat_wxyz
from kr210_sim.viewers.puppet import Puppet
from kr210_sim.viewers.subject import Subject
from kr210_sim.viewers.tables import branches_html, state_html
from kr210_sim.viewers.visuals import plain_bodies, visible_parts

_STEP = 0.1  # of a joint slider [deg]
_FINGER_STEP = 0.1  # [mm]
_AXES = {"axes_length": 0.25, "axes_radius": 0.007}
_DH_AXES = {"axes_length": 0.34, "axes_radius": 0.005}


class ArmPage:
    """The controls and nodes of one robot on a page.

    Args:
        page: where they go.
        subject: the model with the robot in it.

    Attributes:
        page: where they are.
        robot: that is shown.
        q: (6,) the configuration it is in [rad].
    """

    def __init__(self, page: Page, subject: Subject) -> None:
        model, robot, prefix = subject.model, subject.robot, subject.prefix
        self.page, self.robot, self._T_world_base = page, robot, subject.T_world_base
        self._puppet = Puppet(model, prefix=prefix, robot=robot)
        self._shadow = Puppet(model, prefix=prefix, robot=robot)  # stands for each ghost in turn
        self._lock = threading.RLock()
        self._quiet = self._dragging = False
        self._home = np.clip(np.zeros(6), robot.lower, robot.upper)
        self._fingers = robot.finger_open
        page.show(model)
        page.look(subject.first_view())
        self._add_frames()
        self._add_ghosts(model)
        self._add_controls()
        self._show(self._home)

    def _show(self, q: Array) -> None:
        """Show the arm in a configuration q (6,) [rad], and what that means."""
        with self._lock, self.page.server.atomic():
            state = arm_state(self.robot, q)
            poses = self._puppet.place_robot(q, self.robot.finger_positions(self._fingers))
            self._positions = poses[0]
            self.page.pose(*poses)
            self._move_frames(state, *poses)
            self._move_ghosts(state)
            self._poses.content = state_html(state, base=self.robot.root, palm=self.robot.palm)
            self._branches.content = branches_html(state.branches, [css(c) for c in COLORS])
            self.q = state.q

    def reach(self, T_base_palm: Array) -> bool:
        """Put the palm into a pose (4, 4) by the nearest configuration within limits, if any."""
        with self._lock:
            q = nearest_solution(self.robot, T_base_palm, self.q)
            if q is None:
                return False
            self._dragging = True
            try:
                self.move(q)
            finally:
                self._dragging = False
            return True

    def body_positions(self) -> Array:
        """Return where the bodies are drawn (nbody, 3), world frame [m]."""
        return np.array(self._positions)

    # ---- controls -----------------------------------------------------------------------------

    def _add_controls(self) -> None:
        gui, robot = self.page.server.gui, self.robot
        self._sliders, home = [], np.degrees(self._home)
        with gui.add_folder("Joints, degrees"):
            for index, name in enumerate(robot.arm_joints):
                lower, upper = np.degrees([robot.lower[index], robot.upper[index]])
                slider = gui.add_slider(name, _out(lower), _out(upper), _STEP, _out(home[index]))
                slider.on_update(self._slid)
                self._sliders.append(slider)
            opening, closing = 1e3 * robot.finger_open, 1e3 * robot.finger_closed
            low, high = sorted((opening, closing))
            self._finger = gui.add_slider("fingers, mm", low, high, _FINGER_STEP, opening)
            self._finger.on_update(self._slid)
            button = gui.add_button("Home")
            button.on_click(lambda _: self.move(self._home))
        with gui.add_folder("Forward kinematics"):
            self._poses = gui.add_html("")
        with gui.add_folder("Inverse kinematics: the eight branches"):
            self._branches = gui.add_html("")
            self._ghosts_on = gui.add_checkbox("ghosts", True)
            self._beyond_on = gui.add_checkbox("ghosts beyond the limits, too", True)
            self._answer = gui.add_text("reach", "drag the gizmo at the palm", disabled=True)
        with gui.add_folder("Show"):
            boxes = {
                "frame of every link": (self._link_frames, False),
                "DH frames 0 to 7": (self._dh_frames, False),
                "base and TCP": (self._main_frames, True),
                "gizmo at the palm": ([self._gizmo], True),
            }
            for label, (nodes, on) in boxes.items():
                self._add_box(label, nodes, on)
            add_shadow_box(self.page)
        self._ghosts_on.on_update(self._slid)
        self._beyond_on.on_update(self._slid)

    def _add_box(self, label: str, nodes: list[Any], on: bool) -> None:
        box = self.page.server.gui.add_checkbox(label, on)

        def update(_event: Any = None) -> None:
            with self.page.server.atomic():
                for node in nodes:
                    node.visible = box.value

        box.on_update(update)
        update()

    def _slid(self, _event: Any) -> None:
        """Follow the sliders."""
        with self._lock:
            if not self._quiet:
                self._fingers = 1e-3 * self._finger.value
                self._show(self._of_sliders())

    def _of_sliders(self) -> Array:
        q = np.radians([slider.value for slider in self._sliders])
        return np.clip(q, self.robot.lower, self.robot.upper)

    def move(self, q: Array) -> None:
        """Put the arm and the sliders into a configuration q (6,) [rad]."""
        with self._lock:
            self._quiet = True
            try:
                for slider, angle in zip(self._sliders, np.degrees(q), strict=True):
                    slider.value = float(angle)
            finally:
                self._quiet = False
            self._show(q)

    # ---- frames -------------------------------------------------------------------------------

    def _add_frames(self) -> None:
        scene, links = self.page.server.scene, self._puppet.links()
        self._links = {}
        for name, body in links.items():
            frame = scene.add_frame(f"/links/{name}", origin_radius=0.012, **_AXES)
            label = scene.add_label(f"/links/{name}/name", name, font_screen_scale=0.8)
            self._links[body] = (frame, label)
        self._link_frames = [node for pair in self._links.values() for node in pair]
        count = len(self.robot.arm_joints) + 2
        self._dh = [
            scene.add_frame(f"/dh/{i}", origin_radius=0.014, **_DH_AXES) for i in range(count)
        ]
        names = [
            scene.add_label(f"/dh/{i}/name", f"DH {i}", font_screen_scale=0.8) for i in range(count)
        ]
        self._dh_frames = [*self._dh, *names]
        base = scene.add_frame("/base", axes_length=0.5, axes_radius=0.01, origin_radius=0.02)
        T = self._T_world_base
        base.position, base.wxyz = T[:3, 3], quat_wxyz(T[:3, :3])
        self._tcp = scene.add_frame("/tcp", origin_radius=0.014, **_AXES)
        self._wrist = scene.add_icosphere("/wrist_center", radius=0.03, color=(220, 40, 160))
        tags = [
            scene.add_label(f"{node}/tag", text, font_screen_scale=0.9)
            for node, text in (
                ("/base", "base"),
                ("/tcp", "TCP"),
                ("/wrist_center", "wrist center"),
            )
        ]
        self._main_frames = [base, self._tcp, self._wrist, *tags]
        self._gizmo = scene.add_transform_controls("/palm", scale=0.35, depth_test=False)
        self._gizmo.on_update(self._dragged)

    def _move_frames(self, state: ArmState, positions: Array, quats_wxyz: Array) -> None:
        for body, (frame, _) in self._links.items():
            frame.position, frame.wxyz = positions[body], quats_wxyz[body]
        world = self._T_world_base
        placed = [*zip(self._dh, world @ state.T_base_dh, strict=True)]
        placed.append((self._tcp, world @ state.T_base_tcp))
        if not self._dragging:  # or a visitor's hand would be pulled back
            placed.append((self._gizmo, world @ state.T_base_palm))
        for node, T in placed:
            node.position, node.wxyz = T[:3, 3], quat_wxyz(T[:3, :3])
        self._wrist.position = world[:3, :3] @ state.p_base_wrist_center + world[:3, 3]

    def _dragged(self, _event: Any) -> None:
        T_world_palm = np.eye(4)
        T_world_palm[:3, 3] = self._gizmo.position
        T_world_palm[:3, :3] = _rotation(self._gizmo.wxyz)
        reached = self.reach(np.linalg.inv(self._T_world_base) @ T_world_palm)
        self._answer.value = "reached" if reached else "no configuration within limits reaches it"

    # ---- ghosts -------------------------------------------------------------------------------

    def _add_ghosts(self, model: mujoco.MjModel) -> None:
        scene, moving = self.page.server.scene, set(self._puppet.links().values())
        self._ghosts = []
        for part in plain_bodies(visible_parts(model)):
            if part.body not in moving:
                continue
            node = scene.add_batched_meshes_simple(
                f"/ghosts/{part.body}",
                part.vertices,
                part.faces,
                batched_wxyzs=np.array([[1.0, 0.0, 0.0, 0.0]]),
                batched_positions=np.zeros((1, 3)),
                batched_colors=np.array(COLORS[:1]),
                batched_opacities=np.zeros(1),
                opacity=1.0,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
                visible=False,
            )
            self._ghosts.append((part.body, node))

    def _move_ghosts(self, state: ArmState) -> None:
        shown = place_ghosts(self._shadow, state, beyond=self._beyond_on.value)
        for body, node in self._ghosts:
            rows = shown.seen[:, body]
            node.visible = bool(self._ghosts_on.value and rows.any())
            if node.visible:
                node.batched_positions = shown.positions[rows, body].astype(np.float32)
                node.batched_wxyzs = shown.quats_wxyz[rows, body].astype(np.float32)
                node.batched_colors = (255 * shown.colors[rows]).astype(np.uint8)
                node.batched_opacities = shown.opacities[rows].astype(np.float32)


def _rotation(quat: Array) -> Array:
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, np.asarray(quat, dtype=float))
    return flat.reshape(3, 3)


def _out(angle: float) -> float:
    """Return a limit of a slider [deg], clear of rounding in binary."""
    return round(float(angle), 6)
