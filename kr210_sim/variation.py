"""A randomisation block in one cycle: the target as it stands, and what else differs from plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from kr210_sim.arrays import Array
from kr210_sim.draws import Draws, Value
from kr210_sim.gripper import JAW_TILT, PAD_FRICTION
from kr210_sim.randomize import Randomization
from kr210_sim.room import Room
from kr210_sim.scene import Scene, Target
from kr210_sim.simulation import Simulation
from kr210_sim.task import standing

REDRAWS = 1000
"""Draws after which a range counts as impossible in a scene."""

_PLACING = (
    "target_x_m",
    "target_y_m",
    "target_yaw_rad",
    "target_radius_m",
    "target_length_m",
)
"""What decides whether a target stands free; drawn together until it does."""

_SEEN_BESIDE = ("perceived_shift_m", "perceived_depth_m")
"""What makes the jaws close beside the target's middle."""


@dataclass(frozen=True, kw_only=True)
class Variation:
    """What differs in one cycle from the world the planner and the controller believe in.

    Attributes:
        drawn: quantity -> value of everything that was drawn, for the record.
        T_base_perceived: (4, 4) target pose that the planner is told, None for the true one.
        mass_at_most: heaviest target that may come [kg], None if its mass is known.
        pad_friction: coefficient of the pads, None for the description's.
        grip_friction: coefficient that motions may count on, whatever is drawn.
        gain: (6,) factor of each arm servo's force, None for 1.
        delay: by which commands reach the servos late [s].
        payload: mass at the TCP that no controller knows of [kg].
        q_start: (6,) configuration the cycle starts from [rad], None for home.
        draws: where the errors of further looks at the target come from, None for no errors.
    """

    drawn: dict[str, Value] = field(default_factory=dict)
    T_base_perceived: Array | None = None
    mass_at_most: float | None = None
    pad_friction: float | None = None
    grip_friction: float = PAD_FRICTION
    gain: Array | None = None
    delay: float = 0.0
    payload: float = 0.0
    q_start: Array | None = None
    draws: Draws | None = None

    def look(
        self, T_base_target: Array, T_base_cell: Array
    ) -> tuple[Array | None, dict[str, Value]]:
        """Look at a target once more: its pose as seen, None if as it is, and what was drawn."""
        if self.draws is None:
            return None, {}
        return _look(T_base_target, T_base_cell, self.draws)

    def believed(self, target: Target, scene: Scene) -> Target:
        """Return a target as planning takes it to be.

        Seen with an error, but standing on its board; of its size, which is that of the product;
        as heavy as the heaviest that may come.
        """
        seen = target.T_base_target if self.T_base_perceived is None else self.T_base_perceived
        T = standing(seen, scene.cell(target.cell).T_base_cell, target.length)
        mass = target.mass if self.mass_at_most is None else self.mass_at_most
        return replace(target, T_base_target=T, mass=mass, com=0.0, friction=None)

    def prepare(self, simulation: Simulation, target: Target) -> None:
        """Make a world that of the cycle, and measure its target."""
        simulation.alter_robot(pad_friction=self.pad_friction, gain=self.gain, payload=self.payload)
        simulation.watch(target)
        if self.q_start is not None:
            simulation.begin_at(self.q_start)


def check_block(randomization: Randomization, scene: Scene, target_length: float) -> None:
    """Check what depends on robot and scene.

    Args:
        randomization: the block.
        scene: with its robot.
        target_length: of a target whose length is not random [m].

    Raises:
        BadInput: naming file, field and remedy.
    """
    robot = scene.robot
    mass = randomization.bounds("target_mass_kg")
    if mass is not None and mass[1] > robot.max_payload:
        raise randomization.refused(
            "target_mass_kg",
            f"{mass[1]:g} kg is more than the grip holds; give at most {robot.max_payload:.3g}",
        )
    cell = randomization.bounds("cell")
    if cell is not None and cell[1] > len(scene.cells):
        raise randomization.refused(
            "cell", f"scene '{scene.name}' has no cell {cell[1]:g}; give 1 to {len(scene.cells)}"
        )
    com, length = randomization.bounds("target_com_m"), randomization.bounds("target_length_m")
    if com is not None and length is None and max(map(abs, com)) > target_length / 6:
        raise randomization.refused(
            "target_com_m",
            f"{max(map(abs, com)):g} m is more than a sixth of the target's length; give at most "
            f"{target_length / 6:.4g}",
        )


def vary(
    scene: Scene, targets: Sequence[Target], seeds: Sequence[int], randomization: Randomization
) -> list[tuple[Target, Variation]]:
    """Draw everything random about some cycles; each draws from its own seed alone.

    A target that would touch a fixture or stand over the edge of its board is drawn again, and so
    is a start configuration without clearance.

    Args:
        scene: world and robot.
        targets: one per cycle, as it would be without randomisation.
        seeds: of the cycles.
        randomization: the block.

    Returns:
        For each cycle the target as it is, and the rest.

    Raises:
        BadInput: if a range leaves no room in this scene.
    """
    radius = randomization.bounds("target_radius_m")
    length = randomization.bounds("target_length_m")
    largest = replace(
        targets[0],
        radius=radius[1] if radius else targets[0].radius,
        length=length[1] if length else targets[0].length,
    )
    room = Room(scene, largest)
    return [
        _vary(scene, room, target, seed, randomization)
        for target, seed in zip(targets, seeds, strict=True)
    ]


def _vary(
    scene: Scene, room: Room, target: Target, seed: int, randomization: Randomization
) -> tuple[Target, Variation]:
    draws = Draws(randomization.block, seed)
    drawn: dict[str, Value] = {"cell": target.cell} if "cell" in draws else {}

    def number(name: str, default: float) -> float:
        if name in draws:
            drawn[name] = default = draws.number(name)
        return default

    def own(name: str) -> float | None:
        return number(name, 0.0) if name in draws else None

    def vector(name: str) -> Array | None:
        if name not in draws:
            return None
        drawn[name] = values = draws.vector(name)
        return np.array(values)

    target = _placed(scene, room, target, draws, drawn, randomization)
    target = replace(
        target,
        mass=number("target_mass_kg", target.mass),
        com=number("target_com_m", target.com),
        friction=own("target_friction"),
    )
    T_base_perceived, errors = _look(
        target.T_base_target, scene.cell(target.cell).T_base_cell, draws
    )
    drawn.update(errors)
    mass = randomization.bounds("target_mass_kg")
    variation = Variation(
        drawn=drawn,
        mass_at_most=None if mass is None else mass[1],
        T_base_perceived=T_base_perceived,
        pad_friction=own("pad_friction"),
        grip_friction=_grip_friction(randomization),
        gain=vector("actuator_gain"),
        delay=number("actuator_delay_s", 0.0),
        payload=number("payload_kg", 0.0),
        q_start=_start(room, target, draws, drawn, randomization),
        draws=draws,
    )
    return target, variation


def _grip_friction(randomization: Randomization) -> float:
    """Return the friction coefficient that motions may count on.

    The least that pads may have; and where a target may be seen beside where it stands, it may be
    held off the middle of the jaws, one tilted pad of each finger holding it. Friction of angle phi
    on a surface tilted by alpha holds against what the tilt pushes out as one of phi - alpha does.
    """
    pads = randomization.bounds("pad_friction")
    least = PAD_FRICTION if pads is None else pads[0]
    if any(name in randomization.block for name in _SEEN_BESIDE):
        least = float(np.tan(max(np.arctan(least) - JAW_TILT, 0.0)))
    return least


def _look(
    T_base_target: Array, T_base_cell: Array, draws: Draws
) -> tuple[Array | None, dict[str, Value]]:
    """Return a pose (4, 4) as seen with errors, None if it is seen as it is, and these errors."""
    drawn: dict[str, Value] = {}
    seen = T_base_target.copy()
    if "perceived_shift_m" in draws:
        drawn["perceived_shift_m"] = shift = draws.vector("perceived_shift_m")
        seen[:3, 3] += shift
    if "perceived_turn_rad" in draws:
        drawn["perceived_turn_rad"] = turn = draws.vector("perceived_turn_rad")
        seen[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ seen[:3, :3]
    if "perceived_depth_m" in draws:
        drawn["perceived_depth_m"] = depth = draws.number("perceived_depth_m")
        seen[:3, 3] += depth * T_base_cell[:3, 0]
    return (seen if drawn else None), drawn


def _placed(
    scene: Scene,
    room: Room,
    target: Target,
    draws: Draws,
    drawn: dict[str, Value],
    randomization: Randomization,
) -> Target:
    """Return the target with drawn size and place, drawn again until it stands free."""
    names = [name for name in _PLACING if name in draws]
    if not names:
        return target
    for _ in range(REDRAWS):
        values = {name: draws.number(name) for name in names}
        length = values.get("target_length_m", target.length)
        T = scene.stand_in_cell(target.cell, length)
        shift = np.array([values.get("target_x_m", 0.0), values.get("target_y_m", 0.0)])
        yaw = Rotation.from_rotvec([0.0, 0.0, values.get("target_yaw_rad", 0.0)])
        T[:3, 3] += T[:3, :2] @ shift
        T[:3, :3] = T[:3, :3] @ yaw.as_matrix()
        radius = values.get("target_radius_m", target.radius)
        found = replace(target, T_base_target=T, radius=radius, length=length)
        if room.stands_free(found):
            drawn.update(values)
            return found
    raise randomization.refused(
        names[0],
        f"in {REDRAWS} draws no target stands free on its board in cell {target.cell}; give "
        "narrower ranges",
    )


def _start(
    room: Room,
    target: Target,
    draws: Draws,
    drawn: dict[str, Value],
    randomization: Randomization,
) -> Array | None:
    """Return a start configuration (6,) that is clear, None for home."""
    if "start_rad" not in draws:
        return None
    for _ in range(REDRAWS):
        values = draws.vector("start_rad")
        if room.clear(np.array(values)[None], target):
            drawn["start_rad"] = values
            return np.array(values)
    raise randomization.refused(
        "start_rad",
        f"in {REDRAWS} draws no configuration is within the joint limits and clear of everything; "
        "give narrower ranges",
    )
