"""Messages: classes with the fields and defaults of the ROS messages that course files use."""

from __future__ import annotations

from typing import Any

from kr210_sim.grading.stand_ins.clock import Duration, Time


class Message:
    """A message; like the originals it has exactly the fields of its type.

    Arguments are all fields in order, or some of them by name.
    """

    __slots__: tuple[str, ...] = ()
    defaults: dict[str, Any] = {}  # noqa: RUF012 (set once by `message`, never written)

    def __init__(self, *values: Any, **named: Any) -> None:
        names = type(self).__slots__
        if values and (len(values) != len(names) or named):
            kind = type(self).__name__
            raise TypeError(f"{kind} takes all of {', '.join(names)}, or some of them by name")
        for name in named:
            if name not in names:
                raise AttributeError(f"{type(self).__name__} has no field {name}")
        given = dict(zip(names, values, strict=False)) | named
        for name in names:
            default = self.defaults[name]
            setattr(self, name, given.get(name, default() if callable(default) else default))

    def __repr__(self) -> str:
        return "\n".join(f"{name}: {getattr(self, name)!r}" for name in type(self).__slots__)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(
            getattr(self, name) == getattr(other, name) for name in type(self).__slots__
        )

    __hash__ = None  # type: ignore[assignment]


def message(type_name: str, **fields: Any) -> type[Message]:
    """Return a class of messages.

    Args:
        type_name: of the class.
        fields: name -> default value, or a function that makes one.
    """
    content = {"__slots__": tuple(fields), "defaults": fields, "__module__": __name__}
    return type(type_name, (Message,), content)


Header = message("Header", seq=0, stamp=Time, frame_id="")
String = message("String", data="")
Bool = message("Bool", data=False)
Float64 = message("Float64", data=0.0)
Float32 = message("Float32", data=0.0)
Int32 = message("Int32", data=0)
Float64MultiArray = message("Float64MultiArray", layout=None, data=list)

Point = message("Point", x=0.0, y=0.0, z=0.0)
Vector3 = message("Vector3", x=0.0, y=0.0, z=0.0)
Quaternion = message("Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
Pose = message("Pose", position=Point, orientation=Quaternion)
PoseStamped = message("PoseStamped", header=Header, pose=Pose)
PoseArray = message("PoseArray", header=Header, poses=list)
PointStamped = message("PointStamped", header=Header, point=Point)
Transform = message("Transform", translation=Vector3, rotation=Quaternion)
TransformStamped = message(
    "TransformStamped", header=Header, child_frame_id="", transform=Transform
)
Twist = message("Twist", linear=Vector3, angular=Vector3)

JointTrajectoryPoint = message(
    "JointTrajectoryPoint",
    positions=list,
    velocities=list,
    accelerations=list,
    effort=list,
    time_from_start=Duration,
)
JointTrajectory = message("JointTrajectory", header=Header, joint_names=list, points=list)
JointState = message(
    "JointState", header=Header, name=list, position=list, velocity=list, effort=list
)

MODULES = {
    "std_msgs.msg": (Header, String, Bool, Float64, Float32, Int32, Float64MultiArray),
    "geometry_msgs.msg": (
        Point, Vector3, Quaternion, Pose, PoseStamped, PoseArray, PointStamped, Transform,
        TransformStamped, Twist,
    ),
    "trajectory_msgs.msg": (JointTrajectory, JointTrajectoryPoint),
    "sensor_msgs.msg": (JointState,),
}  # fmt: skip
"""Name of each module of messages -> its classes."""
