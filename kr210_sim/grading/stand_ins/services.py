"""Services: requests and responses of the course's own service and of the simulator's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from kr210_sim.grading.stand_ins.messages import Message, Point, Pose, Quaternion, message

CalculateIKRequest = message("CalculateIKRequest", poses=list)
CalculateIKResponse = message("CalculateIKResponse", points=list)
GetJointPropertiesRequest = message("GetJointPropertiesRequest", joint_name="")
GetJointPropertiesResponse = message(
    "GetJointPropertiesResponse",
    type=0,
    damping=list,
    position=list,
    rate=list,
    success=False,
    status_message="",
)


class ServiceType(NamedTuple):
    """What a node names to offer or call a service."""

    name: str
    request: type[Message]
    response: type[Message]


CalculateIK = ServiceType("CalculateIK", CalculateIKRequest, CalculateIKResponse)
GetJointProperties = ServiceType(
    "GetJointProperties", GetJointPropertiesRequest, GetJointPropertiesResponse
)

MODULES: dict[str, dict[str, Any]] = {
    "kuka_arm.srv": {
        "CalculateIK": CalculateIK,
        "CalculateIKRequest": CalculateIKRequest,
        "CalculateIKResponse": CalculateIKResponse,
    },
    "gazebo_msgs.srv": {
        "GetJointProperties": GetJointProperties,
        "GetJointPropertiesRequest": GetJointPropertiesRequest,
        "GetJointPropertiesResponse": GetJointPropertiesResponse,
    },
}
"""Name of each module of services -> its names."""


def calculate_ik_request(
    positions: Sequence[Sequence[float]], quaternions_xyzw: Sequence[Sequence[float]]
) -> Message:
    """Return the request that `handle_calculate_IK` receives for some poses."""
    pairs = zip(positions, quaternions_xyzw, strict=True)
    return CalculateIKRequest([Pose(Point(*place), Quaternion(*turn)) for place, turn in pairs])
