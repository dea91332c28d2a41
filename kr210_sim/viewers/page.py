"""A page in the browser: its server, its light and floor, and the bodies of a model on it."""

from __future__ import annotations

import importlib
import io
import time
from contextlib import suppress
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from kr210_sim.arrays import Array
from kr210_sim.exceptions import BadInput
from kr210_sim.viewers.address import check_address, in_use
from kr210_sim.viewers.puppet import View
from kr210_sim.viewers.visuals import Part, visible_floors, visible_parts

EXTRA = "pip install 'kr210-sim[view]'"

PANEL_WIDTH = 470.0  # [pixels], fits four columns of six decimals and eight branches

_AMBIENT = 0.4
"""Intensity of the light from all around."""

_LIGHTS = (((-3.0, -4.0, 8.0), 1.6, True), ((-4.0, 6.0, 3.0), 0.4, False))
"""Where each light comes from, its intensity, and whether it casts shadows."""

_WIDEN = 1.3
"""A camera of the model sees this much more, as the panel takes a part of the window."""

_FLOOR_SIZE = 40.0  # [m]


def load_viser() -> ModuleType:
    """Return viser.

    Raises:
        BadInput: if it is not installed, with the line that does.
    """
    try:
        viser = importlib.import_module("viser")
    except ModuleNotFoundError as error:
        raise BadInput(f"the viewer in the browser needs the extra 'view': {EXTRA}") from error
    return viser


class Page:
    """A page that shows a model; its controls are added by those who use it.

    Args:
        host: address to listen on; whoever reaches it can use the page.
        port: to listen on.
        title: of the panel.

    Attributes:
        server: viser's.
        host: that it listens on.
        url: where the page is.

    Raises:
        BadInput: if the extra is missing, or the place cannot be listened on.
    """

    def __init__(self, host: str, port: int, title: str) -> None:
        viser = load_viser()
        check_address(host, port)
        import rich

        rich.get_console().quiet = True  # viser speaks on stdout, which is ours
        self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        # No visitor may open a tunnel to the outside.
        self.server.request_share_url = _refuse_share
        if self.server.get_port() != port:
            self.server.stop()
            raise in_use(host, port)
        self.host = host
        name = f"[{host}]" if ":" in host else host
        self.url = f"http://{name}:{port}"
        self._nodes: list[Any] = []
        self._bodies: dict[int, Any] = {}
        self._casting: list[Any] = []
        self._dress()

    def _dress(self) -> None:
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, dark_mode=False
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        scene.set_up_direction("+z")
        scene.world_axes.visible = False
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map("studio", environment_intensity=_AMBIENT)
        for index, (place, intensity, shadow) in enumerate(_LIGHTS):
            light = scene.add_light_directional(
                f"/lights/{index}", position=place, intensity=intensity, cast_shadow=shadow
            )
            if shadow:
                self._casting.append(light)

    def cast_shadows(self, on: bool) -> None:
        """Let the light cast shadows or not: without a GPU they cost the most."""
        for light in self._casting:
            light.cast_shadow = on

    def show(self, model: mujoco.MjModel) -> None:
        """Draw a model in place of what was drawn before."""
        scene = self.server.scene
        with self.server.atomic():
            for node in self._nodes:
                node.remove()
            self._nodes, self._bodies = [], {}
            for index, floor in enumerate(visible_floors(model)):
                self._nodes.append(self._floor(f"/floor/{index}", floor.T_world_plane, floor.rgba))
            for index, part in enumerate(visible_parts(model)):
                if part.body not in self._bodies:
                    node = scene.add_frame(f"/bodies/{part.body}", show_axes=False)
                    self._nodes.append(node)
                    self._bodies[part.body] = node
                scene.add_glb(f"/bodies/{part.body}/{index}", glb_data=glb(part))

    def _floor(self, name: str, T: Array, rgba: tuple[float, ...]) -> Any:
        plain = tuple(int(255 * value) for value in rgba[:3])
        line = tuple(int(0.9 * value) for value in plain)
        return self.server.scene.add_grid(
            name,
            width=_FLOOR_SIZE,
            height=_FLOOR_SIZE,
            cell_color=line,
            section_color=line,
            cell_thickness=0.6,
            section_thickness=1.0,
            fade_distance=_FLOOR_SIZE / 2,
            shadow_opacity=0.35,
            plane_color=plain,
            plane_opacity=rgba[3],
            position=T[:3, 3],
            wxyz=quat_wxyz(T[:3, :3]),
        )

    def pose(self, positions: Array, quats_wxyz: Array) -> None:
        """Move the bodies: (nbody, 3) [m] and (nbody, 4), world frame."""
        with self.server.atomic():
            for body, node in self._bodies.items():
                node.position, node.wxyz = positions[body], quats_wxyz[body]

    def look(self, view: View) -> None:
        """Put every visitor's camera, and those of the visitors to come, at a view."""
        initial = self.server.initial_camera
        for camera in (initial, *(client.camera for client in self.server.get_clients().values())):
            camera.position, camera.look_at = view.position, view.look_at
            camera.fov = 2 * float(np.arctan(_WIDEN * np.tan(view.fovy / 2)))

    def follow(self, shift: Array) -> None:
        """Move every visitor's camera, and what it looks at, by a shift (3,) [m]."""
        for client in self.server.get_clients().values():
            camera = client.camera
            if camera.update_timestamp:  # it has told where it is
                position, look_at = camera.position + shift, camera.look_at + shift
                camera.position, camera.look_at = position, look_at

    def wait(self) -> None:
        """Wait for an interrupt."""
        while True:
            time.sleep(1.0)

    def close(self) -> None:
        """Take the page off; a second time does nothing."""
        with suppress(RuntimeError):
            self.server.stop()


def add_shadow_box(page: Page, order: float | None = None) -> None:
    """Add the choice of shadows to a page."""
    box = page.server.gui.add_checkbox("shadows (slow without a GPU)", True, order=order)
    box.on_update(lambda _: page.cast_shadows(box.value))


def _refuse_share(*_args: Any, **_options: Any) -> None:
    return None


def glb(part: Part) -> bytes:
    """Return a part as binary glTF, with a material for physically based light."""
    linear = [_linear(value) for value in part.rgba[:3]]
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[*linear, part.rgba[3]],
        metallicFactor=0.0,
        roughnessFactor=float(np.clip(1.0 - 1.2 * part.shininess, 0.2, 0.95)),
        alphaMode="BLEND" if part.rgba[3] < 1.0 else "OPAQUE",
        doubleSided=True,
    )
    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(material=material)
    with io.BytesIO() as buffer:
        mesh.export(buffer, file_type="glb", include_normals=True)
        return buffer.getvalue()


def _linear(value: float) -> float:
    """Return a channel of an sRGB colour as linear light."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def quat_wxyz(rotation: Array) -> Array:
    """Return a rotation matrix (..., 3, 3) as quat_wxyz (..., 4)."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(scalar_first=True))
