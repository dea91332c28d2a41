"""The physics of every simulation, in one place: what a scene file asks otherwise is replaced."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from kr210_sim.mjcf import TIMESTEP

OPTIONS = {
    "timestep": TIMESTEP,
    "integrator": mujoco.mjtIntegrator.mjINT_EULER,
    "solver": mujoco.mjtSolver.mjSOL_NEWTON,
    "cone": mujoco.mjtCone.mjCONE_ELLIPTIC,
    "jacobian": mujoco.mjtJacobian.mjJAC_DENSE,
    "impratio": 10.0,
    "gravity": (0.0, 0.0, -9.81),
    # A diverging simulation must be seen and scored, not silently reset.
    "disableflags": int(mujoco.mjtDisableBit.mjDSBL_AUTORESET),
    # Targets at rest in the bin need no solving; the one being picked never sleeps.
    "enableflags": int(mujoco.mjtEnableBit.mjENBL_SLEEP),
}
"""Elliptic cones with impratio 10 keep a grasp from creeping; the dense Jacobian avoids the sparse
path that MuJoCo 4.0.0 computes wrongly."""

_COMPILER = (
    "boundmass",
    "boundinertia",
    "settotalmass",
    "balanceinertia",
    "inertiafromgeom",
    "inertiagrouprange",
    "alignfree",
)
"""Compiler settings that change masses and inertias of robot and targets as well."""

_CONTACT = ("solref", "solimp", "solmix", "margin", "gap", "priority", "contype", "conaffinity")

PLAIN_CONTACT = {
    name: np.array(getattr(mujoco.MjSpec().worldbody.add_geom(), name)).tolist()
    for name in _CONTACT
}
"""Contact settings of a geom that no default class has changed."""


def apply_physics(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Put our physics into a scene's spec.

    Returns:
        What the scene had set otherwise, a sentence each.
    """
    plain = mujoco.MjSpec()
    notes = []
    default = mujoco.MjOption()
    for name in (name for name in dir(default) if not name.startswith("_")):
        if hasattr(spec.option, name):
            ours = OPTIONS.get(name, getattr(default, name))
            notes += _replace(spec.option, name, ours, getattr(default, name), "option")
    for name in (name for name in _COMPILER if hasattr(spec.compiler, name)):
        ours = getattr(plain.compiler, name)
        notes += _replace(spec.compiler, name, ours, ours, "compiler setting")
    return tuple(notes)


def _replace(settings: Any, name: str, ours: Any, default: Any, kind: str) -> list[str]:
    theirs = np.array(getattr(settings, name)).tolist()
    setattr(settings, name, ours)
    ours, default = np.array(ours).tolist(), np.array(default).tolist()
    if theirs in (ours, default):
        return []
    return [f"scene {kind} {name} = {theirs} is replaced by {ours}"]
