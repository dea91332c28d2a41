"""The clearance oracle that planning asks, answered by MuJoCo's own collision detection."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cache
from itertools import product

import mujoco
import numpy as np
from numpy.typing import NDArray

from kr210_sim.advance import advance
from kr210_sim.arrays import Array
from kr210_sim.boxes import BoxPairs
from kr210_sim.criteria import CLEARANCE_CAP
from kr210_sim.planning import Hand
from kr210_sim.scene import ROBOT_PREFIX, Scene, Target
from kr210_sim.simulation import Simulation

TOLERANCE = 1e-3
"""What is looked at keeps this much more than the clearance [m], so that steps have a least length;
a path that keeps it everywhere is never refused."""

_GAUGE = 3e-3
"""Uncertainty of a clearance that is measured [m]."""

_SELF_CLEARANCE = 0.002
"""Kept between links of the robot itself [m]; neighbours of neighbours are always close."""

_NEAR_SELF = 0.1
"""Distance up to which links see each other [m]."""

_NEAR = CLEARANCE_CAP + 0.1
"""Distance up to which what moves and what is fixed see each other [m]. The wider, the longer the
steps and the dearer each of them; 0.2 m is about the optimum."""

_FIXTURE, _ROBOT, _FINGER, _TARGET, _SUPPORT = range(5)  # roles of geoms
_IGNORED, _SELF, _FREE = range(3)  # kinds of pairs
_HELD = (Hand.LIFTING, Hand.HOLDING)

_JOINTS = np.arange(6)
_FIXED, _BASE, _HAND, _GROUPS = (
    0,
    1,
    7,
    8,
)  # groups: what hangs on arm joint j, up to the next, is _BASE + j
_PAIRS = np.array(
    [(_FIXED, b) for b in range(2, _HAND + 1)]
    + [(a, b) for b in range(3, _HAND + 1) for a in range(1, b - 1)]
)
"""Groups that can come near each other, the one further down the arm second. Neighbours on a joint
are always near; that of base and link 1 is seen at each configuration looked at, and only there."""

_WITHIN = _HAND - 1  # first of the pairs within the robot
_TOGETHER = len(_PAIRS)  # stands for pairs that do not move against each other, or may touch
_BETWEEN = (_JOINTS >= _PAIRS[:, :1] - 1) & (_JOINTS < _PAIRS[:, 1:] - 1)
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True, kw_only=True)
class _Rules:
    """Who may be how near to whom with a hand.

    Attributes:
        kind: of two geoms by their sorts, one of _IGNORED, _SELF, _FREE.
        pair: of two geoms by their sorts, row of `_PAIRS` or _TOGETHER.
        centers, radii: (7, 3), (7,) of balls around all groups but the fixed, in the frame of the
            link that carries them [m].
    """

    kind: NDArray[np.int8]
    pair: NDArray[np.int8]
    centers: Array
    radii: Array


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """What MuJoCo computed at B configurations.

    Attributes:
        row: (n,) index of the configuration at which two geoms are near each other.
        geoms: (n, 2) these two.
        first, second: (n,) their sorts, role * _GROUPS + group.
        distance: (n,) between them [m].
        position, rotation: (B, 7, 3) [m], (B, 7, 3, 3) of base link and joints' links.
        anchor, axis: (B, 6, 3) a point [m] and the direction of each joint axis.
    """

    row: NDArray[np.int64]
    geoms: NDArray[np.int32]
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    distance: Array
    position: Array
    rotation: Array
    anchor: Array
    axis: Array


class MujocoOracle:
    """Clearance of the arm, gripper and held target to everything else in a simulated world.

    It works on its own copy of the model, with contact margins wide enough to see what is near,
    and on the state of the world at the moment it is made: targets that lie in the bin are
    obstacles where they lie.

    Attributes:
        looks: number of configurations looked at so far.
    """

    def __init__(self, simulation: Simulation, scene: Scene, target: Target) -> None:
        robot = scene.robot
        self._model = model = copy.copy(simulation.model)
        self._data = mujoco.MjData(model)
        self._data.qpos[:] = simulation.data.qpos
        self._data.qpos[simulation.addresses.fingers] = robot.open_positions
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
        self._arm = simulation.addresses.arm
        self._joints = np.array([model.joint(ROBOT_PREFIX + n).id for n in robot.arm_joints])
        root = simulation.body_id(robot.root)
        self._links = np.array([root, *model.jnt_bodyid[self._joints]])
        self._tcp = int(model.site(ROBOT_PREFIX + "tcp").id)
        first = int(model.joint(target.name).qposadr[0])
        self._target = self._data.qpos[first : first + 7]
        T = scene.T_world_base @ target.T_base_target
        self._standing = np.empty(7)
        _write_pose(self._standing, T[:3, 3], T[:3, :3].ravel())
        self._role = _roles(simulation, scene, target)
        self._group = _groups(model, self._links)
        self._sort = self._role * _GROUPS + self._group
        mujoco.mj_kinematics(model, self._data)
        self._boxes = BoxPairs(model, self._data, self._group)
        self._box_sorts = self._sort[self._boxes.geoms]
        _collide_by_class(model, self._group >= _BASE, self._role == _TARGET, self._boxes.is_box)
        model.geom_margin[:] = np.where(
            self._group >= _BASE, _NEAR_SELF / 2, _NEAR - _NEAR_SELF / 2
        )
        model.body_margin[:] = 0.0  # what the broad phase goes by
        np.maximum.at(model.body_margin, model.geom_bodyid, model.geom_margin)
        self._rules: dict[Hand, _Rules] = {}
        self._bounds: dict[bool, tuple[Array, Array]] = {}
        self.looks = 0

    def blocked(self, q: Array, *, hand: Hand, clearance: float) -> str | None:
        """Return None if a path keeps a clearance everywhere, else what is near.

        Args:
            q: (N, 6) configurations; the path is the polyline through them [rad].
            hand: what the gripper and the target do.
            clearance: kept to everything else [m], at most CLEARANCE_CAP.
        """
        rules = self._rules_for(hand)
        required = np.array([-np.inf, _SELF_CLEARANCE, clearance])
        what = None

        def look(q: Array) -> Array | None:
            nonlocal what
            seen = self._see(q, hand, required)
            excess = seen.distance - required[rules.kind[seen.first, seen.second]]
            if len(excess) and excess[nearest := int(np.argmin(excess))] < TOLERANCE:
                names = (self._name(int(geom)) for geom in seen.geoms[nearest])
                what = f" within {1000 * seen.distance[nearest]:.0f} mm of ".join(names)
                return None
            return _weights(seen, excess, rules, clearance)

        return None if advance(q, look) else what

    def least(self, q: Array, *, hand: Hand) -> float:
        """Return the least clearance along a path [m], CLEARANCE_CAP if it is more.

        It is a distance that was found; none on the path is less by more than 3 mm. Distances
        within the robot and what it holds do not count.

        Args:
            q: (N, 6) configurations; the path is the polyline through them [rad].
            hand: what the gripper and the target do.
        """
        rules = self._rules_for(hand)
        best = CLEARANCE_CAP

        def look(q: Array) -> Array:
            nonlocal best
            seen = self._see(q, hand, np.array([-np.inf, -np.inf, best]))
            counts = rules.pair[seen.first, seen.second] < _WITHIN
            best = min(best, float(np.min(seen.distance, initial=best, where=counts)))
            required = best - _GAUGE
            return _weights(seen, seen.distance - required, rules, required)[:, :_WITHIN]

        advance(q, look)
        return best

    def _see(self, q: Array, hand: Hand, required: Array) -> _Seen:
        """Return what is near at configurations (B, 6), of each kind at least what is required."""
        model, data, boxes = self._model, self._data, self._boxes
        self.looks += len(q)
        fields = (data.xpos, data.xmat, data.xanchor, data.xaxis, data.geom_xpos)
        copies = [np.empty((len(q), *field.shape)) for field in fields]
        for index, row in enumerate(q):
            data.qpos[self._arm] = row
            self._pose(hand)
            for copied, field in zip(copies, fields, strict=True):
                copied[index] = field
        position, rotation, anchor, axis, centers = copies
        bounds = boxes.bounds(centers)
        box_required = required[_tables(hand)[0][*self._box_sorts.T]]
        geoms, distances, count = [], [], []
        for row, bound in zip(q, bounds, strict=True):
            data.qpos[self._arm] = row
            self._pose(hand)
            mujoco.mj_collision(model, data)
            boxes.sharpen(bound, box_required)
            near = bound < _NEAR
            geoms += [np.array(data.contact.geom), boxes.geoms[near]]
            distances += [np.array(data.contact.dist), bound[near]]
            count += [len(geoms[-2]), len(geoms[-1])]
        joined, distance = np.concatenate(geoms), np.concatenate(distances)
        # Contacts of boxes occur only in models of which `_collide_by_class` leaves the bits.
        is_contact = np.repeat(np.arange(len(count)) % 2 == 0, count)
        keep = ~(is_contact & np.all(boxes.is_box[joined], axis=1))
        joined = joined[keep]
        return _Seen(
            row=np.repeat(np.arange(len(count)) // 2, count)[keep],
            first=self._sort[joined[:, 0]],
            second=self._sort[joined[:, 1]],
            geoms=joined,
            distance=distance[keep],
            position=position[:, self._links],
            rotation=rotation[:, self._links].reshape(-1, 7, 3, 3),
            anchor=anchor[:, self._joints],
            axis=axis[:, self._joints],
        )

    def _pose(self, hand: Hand) -> None:
        """Compute where everything is, the target in the hand or where it stands."""
        model, data = self._model, self._data
        self._target[:] = self._standing
        mujoco.mj_kinematics(model, data)
        if hand in _HELD:
            # The pick options all put the TCP on the target's centre, z along its axis.
            _write_pose(self._target, data.site_xpos[self._tcp], data.site_xmat[self._tcp])
            mujoco.mj_kinematics(model, data)

    def _rules_for(self, hand: Hand) -> _Rules:
        if hand not in self._rules:
            kind, pair = _tables(hand)
            held = hand in _HELD
            if held not in self._bounds:
                self._bounds[held] = self._balls(hand)
            centers, radii = self._bounds[held]
            self._rules[hand] = _Rules(kind=kind, pair=pair, centers=centers, radii=radii)
        return self._rules[hand]

    def _balls(self, hand: Hand) -> tuple[Array, Array]:
        """Return balls around the boxes around the geoms of each group but the fixed."""
        model, data = self._model, self._data
        group = np.where(self._role == _TARGET, _HAND if hand in _HELD else _FIXED, self._group)
        self._pose(hand)
        centers, radii = np.zeros((_HAND, 3)), np.zeros(_HAND)
        solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        for index, link in enumerate(self._links):
            geoms = np.flatnonzero(solid & (group == _BASE + index))
            if not len(geoms):
                continue
            middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
            corners = middle[:, None] + half[:, None] * _CORNERS
            rotation = data.geom_xmat[geoms].reshape(-1, 1, 3, 3)
            corners = (rotation @ corners[..., None])[..., 0] + data.geom_xpos[geoms][:, None]
            corners = (corners.reshape(-1, 3) - data.xpos[link]) @ data.xmat[link].reshape(3, 3)
            centers[index] = (np.min(corners, axis=0) + np.max(corners, axis=0)) / 2
            radii[index] = np.sqrt(np.max(np.sum((corners - centers[index]) ** 2, axis=1)))
        return centers, radii

    def _name(self, geom: int) -> str:
        return str(self._model.body(int(self._model.geom_bodyid[geom])).name or "world")


@cache
def _tables(hand: Hand) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Return kind and pair of two geoms by their sorts."""
    role, group = np.divmod(np.arange(_GROUPS * (_SUPPORT + 1)), _GROUPS)
    low, high = np.minimum(role[:, None], role), np.maximum(role[:, None], role)
    on_target = (low == _TARGET) | (high == _TARGET)
    group = np.where(role == _TARGET, _HAND if hand in _HELD else _FIXED, group)
    kind = np.full(low.shape, _FREE, dtype=np.int8)
    robot = (role == _ROBOT) | (role == _FINGER)
    kind[robot[:, None] & robot] = _SELF
    kind[(group[:, None] == _HAND) & (group == _HAND)] = _SELF
    kind[(group[:, None] == _FIXED) & (group == _FIXED)] = _IGNORED
    if hand is Hand.RELEASED:
        kind[on_target] = _IGNORED
    if hand in _HELD:
        kind[(low == _FINGER) & (high == _TARGET)] = _IGNORED
    if hand is Hand.LIFTING:
        kind[(low == _TARGET) & (high == _SUPPORT)] = _IGNORED
    rows = np.full((_GROUPS, _GROUPS), _TOGETHER, dtype=np.int8)
    one, other = _PAIRS.T
    rows[one, other] = rows[other, one] = np.arange(_TOGETHER)
    return kind, np.where(kind == _IGNORED, _TOGETHER, rows[group[:, None], group])


def _weights(seen: _Seen, excess: Array, rules: _Rules, clearance: float) -> Array:
    """Return how travel of the joints uses up the room: weights (B, P, 6) [1/rad] for `advance`.

    While the joints j between two groups travel |dq_j|, a point of the one further down the arm
    moves by at most sum_j |dq_j| (r_j + room) relative to the other: r_j is its distance from
    axis j at the beginning, and until the room is used up it has come no farther.

    Args:
        seen: at B configurations.
        excess: (n,) distance above what is required of each pair that is near [m].
        rules: of the hand.
        clearance: required of those that are not near each other [m].
    """
    centers = seen.position + (seen.rotation @ rules.centers[:, :, None])[..., 0]
    x, y, z = np.moveaxis(centers[:, 1:, None] - seen.anchor[:, None], 3, 0)
    u, v, w = np.moveaxis(seen.axis[:, None], 3, 0)
    from_axis = np.sqrt((y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2)
    reach = from_axis + rules.radii[1:, None]
    # What is not reported is farther than the margins; links are farther than their balls, too.
    room = np.full((len(reach), _TOGETHER + 1), _NEAR - clearance)
    one, other = _PAIRS[_WITHIN:].T - 1
    gaps = np.sqrt(np.sum((centers[:, one] - centers[:, other]) ** 2, axis=2))
    gaps -= rules.radii[one] + rules.radii[other] + max(clearance, _SELF_CLEARANCE)
    room[:, _WITHIN:_TOGETHER] = np.maximum(_NEAR_SELF - _SELF_CLEARANCE, gaps)
    np.minimum.at(room, (seen.row, rules.pair[seen.first, seen.second]), excess)
    return np.where(_BETWEEN, reach[:, _PAIRS[:, 1] - 2] / room[:, :-1, None] + 1.0, 0.0)


def _write_pose(qpos: Array, position: Array, rotation: Array) -> None:
    """Write a pose into the part (7,) of `qpos` of a free joint; rotation (9,) row by row."""
    qpos[:3] = position
    mujoco.mju_mat2Quat(qpos[3:], rotation)


def _roles(simulation: Simulation, scene: Scene, target: Target) -> NDArray[np.int64]:
    """Return the role of each geom."""
    model = simulation.model
    body_role = np.full(model.nbody, _FIXTURE)
    body_role[simulation.body_id(scene.robot.root)] = _ROBOT
    body_role[[simulation.body_id(name) for name in scene.robot.fingers]] = _FINGER
    for body in range(1, model.nbody):  # parents come first
        body_role[body] = max(body_role[body], body_role[model.body_parentid[body]])
    body_role[model.body(target.name).id] = _TARGET
    role = body_role[model.geom_bodyid]
    role[model.geom(scene.cell(target.cell).support).id] = _SUPPORT
    return np.asarray(role)


def _groups(model: mujoco.MjModel, links: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the group of each geom from the base link and the links of the arm joints (7,)."""
    group = np.full(model.nbody, _FIXED)
    for body in range(1, model.nbody):
        group[body] = group[model.body_parentid[body]]
        if body in links:
            group[body] += 1
    return np.asarray(group[model.geom_bodyid])


def _collide_by_class(
    model: mujoco.MjModel,
    robot: NDArray[np.bool_],
    target: NDArray[np.bool_],
    is_box: NDArray[np.bool_],
) -> None:
    """Set the collision bits so that MuJoCo leaves out what does not count.

    That is what neither moves nor is held, and pairs of boxes, which `BoxPairs` answers for. Only
    where the bits have their usual values; other models take longer, with the same answers.
    """
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    if np.any(model.geom_contype[solid] != 1) or np.any(model.geom_conaffinity[solid] != 1):
        return
    moves = robot | target
    own = np.where(moves, 1, 4) << is_box.astype(np.int64)  # 1, 2: moves; 4, 8: fixed
    meets = np.where(moves, np.where(is_box, 1 | 4, 15), 0)
    model.geom_contype[:] = np.where(solid, own, 0)
    model.geom_conaffinity[:] = np.where(solid, meets, 0)
    model.body_contype[:] = 0
    model.body_conaffinity[:] = 0
    np.bitwise_or.at(model.body_contype, model.geom_bodyid, model.geom_contype)
    np.bitwise_or.at(model.body_conaffinity, model.geom_bodyid, model.geom_conaffinity)
