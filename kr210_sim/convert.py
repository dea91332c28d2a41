"""`convert`: a robot, or a scene with it, as a folder of MJCF that any MuJoCo loads; its proof."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from kr210_sim import __version__
from kr210_sim.exceptions import BadInput
from kr210_sim.loading import RobotModel, load_robot
from kr210_sim.mjcf import SERVO_BANDWIDTH
from kr210_sim.mjcf_files import save_model
from kr210_sim.parity import Finding, check_parity, parity_text
from kr210_sim.scene import build_scene, find_scene
from kr210_sim.source import RobotSource


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """What was written and how it compares.

    Attributes:
        out: the folder.
        files: names of the XML files in it.
        notes: everything that was changed or guessed.
        excluded: pairs of links that do not collide, beside parent and child.
        in_memory, from_disk: parity of the model before and after it was written, if asked for.
    """

    out: Path
    files: tuple[str, ...]
    notes: tuple[str, ...]
    excluded: tuple[tuple[str, str], ...]
    in_memory: tuple[Finding, ...] = ()
    from_disk: tuple[Finding, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether parity holds, where it was checked."""
        return all(finding.passed for finding in (*self.in_memory, *self.from_disk))


def convert(
    source: RobotSource, out: Path, *, scene: str | None = None, check: bool = False
) -> Conversion:
    """Write a robot as MJCF.

    Args:
        source: the robot.
        out: folder to write, new or empty: `<robot>.xml`, `assets/`, README.md, and `scene.xml`
            with a scene.
        scene: name or path of a scene to put the robot in.
        check: compare the model, in memory and loaded again from disk, with the description.

    Raises:
        BadInput: naming file, field and remedy; nothing is written then.
        OSError: if something cannot be written.
    """
    if os.path.exists(out) and (not out.is_dir() or any(out.iterdir())):
        raise BadInput(f"--out: {out} is not empty; name a folder that does not exist yet")
    model = load_robot(source)
    world = None if scene is None else build_scene(find_scene(scene), model.robot, model.spec)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(
            f"--out: {out} cannot be written ({error.strerror}); name another"
        ) from error
    name = re.sub(r"\W+", "_", model.spec.modelname, flags=re.ASCII)[:60].strip("_") or "robot"
    files = [f"{name}.xml" if name != "scene" else "robot.xml"]
    save_model(model.spec, out / files[0])
    notes = model.notes
    if world is not None:
        files.append("scene.xml")
        notes += world.notes
        save_model(world.spec, out / "scene.xml")
    in_memory: tuple[Finding, ...] = ()
    from_disk: tuple[Finding, ...] = ()
    if check:
        compiled, again = model.spec.copy().compile(), out / files[0]
        in_memory = check_parity(model.description, model.robot, compiled)
        loaded = mujoco.MjModel.from_xml_path(str(again))
        from_disk = check_parity(model.description, model.robot, loaded)
    conversion = Conversion(
        out=out,
        files=tuple(files),
        notes=notes,
        excluded=tuple((item.bodyname1, item.bodyname2) for item in model.spec.excludes),
        in_memory=in_memory,
        from_disk=from_disk,
    )
    (out / "README.md").write_text(_readme(conversion, model), encoding="utf-8")
    return conversion


def conversion_text(conversion: Conversion) -> str:
    """Return the report of a conversion for the terminal."""
    lines = [f"written        {conversion.out / file}" for file in conversion.files]
    lines += ["changed or guessed", *_listed(conversion.notes)]
    lines += ["no collision between, beside parent and child", *_listed(_pairs(conversion))]
    for title, findings in (
        ("in memory", conversion.in_memory),
        ("loaded from disk", conversion.from_disk),
    ):
        if findings:
            verdict = "holds" if all(item.passed for item in findings) else "FAILED"
            lines += ["", f"parity with yourdfpy and the URDF, {title}: {verdict}"]
            lines.append(parity_text(findings))
    return "\n".join(lines)


def _pairs(conversion: Conversion) -> list[str]:
    return [f"{first} and {second}, which touch at zero" for first, second in conversion.excluded]


def _listed(items: Sequence[str]) -> list[str]:
    return [f"  - {item}" for item in items] or ["  - nothing"]


def _readme(conversion: Conversion, model: RobotModel) -> str:
    """Return the README of the folder: how it came to be, what is in it, what was guessed."""
    robot = model.robot
    rows = [
        f"| {name} | {robot.lower[i]:.4f} | {robot.upper[i]:.4f} | {robot.velocity[i]:.4f} | "
        f"{robot.effort[i]:g} |"
        for i, name in enumerate(robot.arm_joints)
    ]
    lines = [
        f"# {model.spec.modelname}, converted from {robot.path.name}",
        "",
        f"Written by kr210-sim {__version__} for MuJoCo {mujoco.__version__}. Load it with",
        f'`mujoco.MjModel.from_xml_path("{conversion.files[0]}")`.',
        "The licence of the description holds for this folder, too.",
        "",
        "## Steps",
        "",
        "1. The xacro was expanded, or the URDF read, and checked.",
        "2. Each link became a body of its own; none was fused. Frames, masses, centres of mass",
        "   and inertias are the description's.",
        "3. `<visual>` became geoms of class `visual` (group 2, no contact), `<collision>` geoms",
        "   of class `collision` (group 3); meshes in metres, z up, in `assets/`.",
        "4. Each arm joint got a position servo, force = kp (ctrl - q) - kv qd, critically damped",
        f"   at {SERVO_BANDWIDTH:g} rad/s for its largest reflected inertia, and a rotor",
        "   (armature) that goes with its effort limit. To follow q(t): ctrl = q + (kv/kp) qd.",
        "5. The fingers are coupled; their gripping surfaces got friction 1 and stiff contact.",
        "6. Gravity of the robot's own links is compensated through the motors and counts against",
        "   their limits.",
        "7. Velocity limits, which MJCF does not have, are in the numeric `joint_velocity_limit`.",
        "8. Pairs of links that touch in the zero configuration do not collide.",
        "9. Site `tcp` and keyframe `home` (zero configuration, gripper open) were added.",
        "",
        "## Arm",
        "",
        "| joint | lower rad | upper rad | velocity rad/s | effort N m |",
        "|---|---|---|---|---|",
        *rows,
        "",
        "## Changed or guessed",
        "",
        *[line.strip() for line in _listed(conversion.notes)],
        "",
        "## No collision between, beside parent and child",
        "",
        *[line.strip() for line in _listed(_pairs(conversion))],
    ]
    for title, findings in (
        ("In memory", conversion.in_memory),
        ("Loaded from disk", conversion.from_disk),
    ):
        if findings:
            lines += ["", f"## Parity: {title.lower()}", "", "```", parity_text(findings), "```"]
    return "\n".join(lines) + "\n"
