"""KUKA KR210 pick and place in MuJoCo, from the xacro to the scored cycle.

What a script needs is here and loaded when it is first used; `examples/one_episode.py` uses it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kr210_sim.api import SavedRun as SavedRun
    from kr210_sim.api import build_scene as build_scene
    from kr210_sim.api import load_run as load_run
    from kr210_sim.api import plan_cycle as plan_cycle
    from kr210_sim.api import run_episode as run_episode
    from kr210_sim.compare import compare_runs as compare_runs
    from kr210_sim.config import RunConfig as RunConfig
    from kr210_sim.exceptions import BadInput as BadInput
    from kr210_sim.exceptions import CycleFailure as CycleFailure
    from kr210_sim.exceptions import Kr210SimError as Kr210SimError
    from kr210_sim.runner import run as run
    from kr210_sim.scene import Scene as Scene
    from kr210_sim.scene import list_scenes as list_scenes
    from kr210_sim.schemas import load_schema as load_schema
    from kr210_sim.score import CycleScore as CycleScore
    from kr210_sim.score import score_cycle as score_cycle

__version__ = "0.1.0.dev0"

_HOMES = {
    "BadInput": "exceptions",
    "CycleFailure": "exceptions",
    "CycleScore": "score",
    "Kr210SimError": "exceptions",
    "RunConfig": "config",
    "SavedRun": "api",
    "Scene": "scene",
    "build_scene": "api",
    "compare_runs": "compare",
    "list_scenes": "scene",
    "load_run": "api",
    "load_schema": "schemas",
    "plan_cycle": "api",
    "run": "runner",
    "run_episode": "api",
    "score_cycle": "score",
}
"""Public name -> module that it is loaded from; type checkers read the imports above."""

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    globals()[name] = found = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted(globals().keys() | _HOMES)
