"""The names under which the stand-ins are imported."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType
from typing import Any

from kr210_sim.grading.stand_ins import angles, messages, rospy, services, transformations

_PLOTTING = (
    "matplotlib", "matplotlib.pyplot", "matplotlib.animation", "mpl_toolkits",
    "mpl_toolkits.mplot3d", "pylab",
)  # fmt: skip


class _Inert(ModuleType):
    """A module or object of which every part exists and does nothing."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return _Inert(name)

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Do nothing."""
        return _Inert("result")

    def __iter__(self) -> Any:
        return iter((_Inert("first"), _Inert("second")))  # as in `figure, axes = subplots()`

    def __getitem__(self, _: Any) -> Any:
        return _Inert("item")


def install() -> None:
    """Let imports of the ROS packages that course files use find the stand-ins.

    matplotlib is replaced where it is not installed, by something that draws nothing.
    """
    sys.modules["rospy"] = rospy
    sys.modules["angles"] = angles
    _package("tf", transformations=transformations)
    sys.modules["tf.transformations"] = transformations
    _package("roslib", load_manifest=lambda _name: None)
    for name, classes in messages.MODULES.items():
        _module(name, {item.__name__: item for item in classes})
    for name, content in services.MODULES.items():
        _module(name, content)
    if importlib.util.find_spec("matplotlib") is None:
        for name in _PLOTTING:
            inert = _Inert(name)
            inert.__path__ = []
            sys.modules[name] = inert


def _package(name: str, **content: Any) -> ModuleType:
    package = sys.modules.setdefault(name, ModuleType(name))
    package.__path__ = []
    package.__dict__.update(content)
    return package


def _module(full_name: str, content: dict[str, Any]) -> None:
    parent, _, name = full_name.partition(".")
    module = ModuleType(full_name)
    module.__dict__.update(content)
    sys.modules[full_name] = module
    _package(parent, **{name: module})
