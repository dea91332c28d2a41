"""Where a robot comes from and what is said about it beside its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kr210_sim.exceptions import BadInput


@dataclass(frozen=True, kw_only=True)
class ArmChoice:
    """What the arm is, where the tree does not say it or says it wrongly.

    Attributes:
        base: link that stands at `robot_base`; the root by default.
        tip: link on which the bundled gripper is mounted.
        joints: names of the six joints, base to tip.
        fingers: names of the two finger joints or links.
        gripper: mount the bundled gripper, in the place of what is there.
    """

    base: str | None = None
    tip: str | None = None
    joints: tuple[str, ...] = ()
    fingers: tuple[str, ...] = ()
    gripper: bool = False


@dataclass(frozen=True, kw_only=True)
class RobotSource:
    """Where a robot comes from.

    Attributes:
        path: a .xacro or .urdf; None is the bundled KR210.
        packages: folders by package name.
        arguments: values of `<xacro:arg>` by name.
        choice: what the arm is.
    """

    path: Path | None = None
    packages: Mapping[str, Path] = field(default_factory=dict)
    arguments: Mapping[str, str] = field(default_factory=dict)
    choice: ArmChoice = field(default_factory=ArmChoice)

    @classmethod
    def from_options(
        cls,
        *,
        robot: Path | None,
        package: Sequence[str],
        xacro_arg: Sequence[str],
        gripper: bool,
        base: str | None,
        tip: str | None,
        joints: str | None,
        fingers: str | None,
    ) -> RobotSource:
        """Read the options of the command line of the same names.

        Raises:
            BadInput: if one is not of the form it must have.
        """
        folders = dict(_pair("--package", text, "NAME=DIR") for text in package)
        choice = ArmChoice(
            base=base,
            tip=tip,
            joints=_names("--joints", joints, 6),
            fingers=_names("--fingers", fingers, 2),
            gripper=gripper,
        )
        return cls(
            path=robot,
            packages={name: Path(folder) for name, folder in folders.items()},
            arguments=dict(_pair("--xacro-arg", text, "NAME=VALUE") for text in xacro_arg),
            choice=choice,
        )


def _pair(option: str, text: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not name or not equals or (not value and form.endswith("DIR")):
        raise BadInput(f"{option}: '{text}' is not of the form {form}")
    return name, value


def _names(option: str, text: str | None, count: int) -> tuple[str, ...]:
    if text is None:
        return ()
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if len(set(names)) != count or len(names) != count:
        raise BadInput(f"{option}: '{text}' names {len(names)}; give {count}, separated by commas")
    return names
