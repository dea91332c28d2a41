"""rospy for one node in one process: services are captured, logs kept, time is the clock's."""

from __future__ import annotations

import sys
import time as _time
from collections.abc import Callable
from typing import Any

from kr210_sim.grading.stand_ins.clock import Duration, Time
from kr210_sim.grading.stand_ins.messages import Message
from kr210_sim.grading.stand_ins.services import GetJointPropertiesResponse, ServiceType


class ROSException(Exception):
    """Base class of what rospy raises."""


class ROSInterruptException(ROSException, KeyboardInterrupt):
    """The node was asked to stop."""


class ROSSerializationException(ROSException):
    """A message does not fit its type."""


class ROSInitException(ROSException):
    """The node was not initialised as it must be."""


class ServiceException(Exception):
    """A call of a service failed."""


class World:
    """What surrounds the node.

    Attributes:
        services: offered by the node, in order: name, type and handler.
        serve: answers requests and never returns; `spin` calls it.
        joints: name of a joint -> its angle now [rad].
        handling: whether a request is being answered.
        parameters: of the parameter server.
    """

    def __init__(self) -> None:
        self.services: list[tuple[str, Any, Callable[[Any], Any]]] = []
        self.serve: Callable[[], Any] = lambda: None
        self.joints: dict[str, float] = {}
        self.handling = False
        self.parameters: dict[str, Any] = {}


world = World()

DEBUG, INFO, WARN, ERROR, FATAL = 1, 2, 4, 8, 16


# ---- the node -------------------------------------------------------------------------------


def init_node(name: str, *_: Any, **__: Any) -> None:
    """Name the node."""
    world.parameters.setdefault("~name", name)


def spin() -> None:
    """Answer requests until the node is stopped."""
    world.serve()


def is_shutdown() -> bool:
    """Tell whether the node shall stop; a node that asks in a loop answers requests here."""
    if world.services and not world.handling:
        world.serve()
    return False


def on_shutdown(_function: Callable[[], Any]) -> None:
    """Accept a function that is called when the node stops; it is ended, not stopped."""


def signal_shutdown(_reason: str) -> None:
    """Do nothing: the node stays until it has been judged."""


def get_name() -> str:
    """Return the name of the node."""
    return "/" + str(world.parameters.get("~name", "unnamed"))


def get_namespace() -> str:
    """Return the namespace, the outermost."""
    return "/"


def myargv(argv: list[str] | None = None) -> list[str]:
    """Return the command line without what is meant for ROS."""
    return [text for text in (sys.argv if argv is None else argv) if ":=" not in text]


def get_param(name: str, *default: Any) -> Any:
    """Return a parameter, or the default."""
    if name not in world.parameters and not default:
        raise KeyError(name)
    return world.parameters.get(name, *default)


def has_param(name: str) -> bool:
    """Tell whether a parameter is set."""
    return name in world.parameters


def set_param(name: str, value: Any) -> None:
    """Set a parameter."""
    world.parameters[name] = value


# ---- services and topics --------------------------------------------------------------------


class Service:
    """A service that the node offers; its handler is captured."""

    def __init__(
        self, name: str, service_class: Any, handler: Callable[[Any], Any], *_: Any, **__: Any
    ) -> None:
        self.resolved_name, self.service_class, self.handler = name, service_class, handler
        world.services.append((name, service_class, handler))

    def spin(self) -> None:
        """Answer requests until the node is stopped."""
        spin()

    def shutdown(self, _reason: str = "") -> None:
        """Offer it no longer."""
        world.services = [entry for entry in world.services if entry[2] is not self.handler]


class ServiceProxy:
    """A service of somebody else: the simulator tells joint angles, others do not exist."""

    def __init__(self, name: str, service_class: Any, *_: Any, **__: Any) -> None:
        self.resolved_name, self.service_class = name, service_class

    def __call__(self, *values: Any, **named: Any) -> Any:
        """Ask it."""
        if not isinstance(self.service_class, ServiceType) or not self.resolved_name.endswith(
            "get_joint_properties"
        ):
            raise ServiceException(f"service [{self.resolved_name}] unavailable")
        request = self.service_class.request(*values, **named)
        if values and isinstance(values[0], Message):
            request = values[0]
        name = str(request.joint_name).split("::")[-1].split("/")[-1]  # type: ignore[attr-defined]
        if name not in world.joints:
            text = f"GetJointProperties: joint {name} not found"
            return GetJointPropertiesResponse(status_message=text)
        return GetJointPropertiesResponse(
            position=[world.joints[name]],
            rate=[0.0],
            damping=[0.0],
            success=True,
            status_message="GetJointProperties: got properties",
        )

    call = __call__

    def wait_for_service(self, timeout: float | None = None) -> None:
        """Return at once: it is there or never will be."""

    def close(self) -> None:
        """Forget it."""


def wait_for_service(_name: str, timeout: float | None = None) -> None:
    """Return at once: a service is there or never will be."""


class Publisher:
    """A topic that nobody listens to."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def publish(self, *_: Any, **__: Any) -> None:
        """Send a message to nobody."""

    def get_num_connections(self) -> int:
        """Return how many listen: nobody."""
        return 0

    def unregister(self) -> None:
        """Close the topic."""


class Subscriber:
    """A topic on which nobody speaks."""

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def unregister(self) -> None:
        """Close the topic."""


# ---- time -----------------------------------------------------------------------------------


class Rate:
    """A loop that runs so many times a second."""

    def __init__(self, hz: float, *_: Any) -> None:
        self.sleep_dur = Duration(1.0 / hz)

    def sleep(self) -> None:
        """Wait for the next turn."""
        sleep(self.sleep_dur)


def get_rostime() -> Time:
    """Return the present instant."""
    return Time.now()


def get_time() -> float:
    """Return the present instant [s]."""
    return _time.time()


def sleep(duration: Any) -> None:
    """Wait [s]."""
    _time.sleep(duration.to_sec() if isinstance(duration, Duration) else duration)


# ---- logs -----------------------------------------------------------------------------------


def _logger(level: str) -> Callable[..., None]:
    def log(text: Any, *values: Any, **_: Any) -> None:
        line = str(text) % values if values else str(text)
        sys.stdout.write(f"[{level}] {line}\n")

    return log


def _throttled(level: str) -> Callable[..., None]:
    log, last = _logger(level), dict[str, float]()

    def throttle(period: float, text: Any, *values: Any) -> None:
        if _time.time() - last.get(str(text), 0.0) >= period:
            last[str(text)] = _time.time()
            log(text, *values)

    return throttle


def _once(level: str) -> Callable[..., None]:
    log, seen = _logger(level), set[str]()

    def once(text: Any, *values: Any) -> None:
        if str(text) not in seen:
            seen.add(str(text))
            log(text, *values)

    return once


logdebug, loginfo, logwarn = _logger("DEBUG"), _logger("INFO"), _logger("WARN")
logerr, logfatal = _logger("ERROR"), _logger("FATAL")
loginfo_once, logwarn_once, logerr_once = _once("INFO"), _once("WARN"), _once("ERROR")
loginfo_throttle, logwarn_throttle = _throttled("INFO"), _throttled("WARN")
logerr_throttle = _throttled("ERROR")
