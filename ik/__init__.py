"""Analytic inverse kinematics of six-axis arms with a spherical wrist, in NumPy alone.

The public names are those of `names.py`. NumPy is loaded with the first of them that is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .names import *  # noqa: F403
else:  # or a type checker would take any name for a public one

    def __getattr__(name: str) -> Any:
        """Load a public name when it is first asked for (PEP 562)."""
        names = import_module(".names", __name__)
        if name != "__all__" and name not in names.__all__:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        globals()[name] = found = getattr(names, name)
        return found

    def __dir__() -> list[str]:
        return sorted({*globals(), *__getattr__("__all__")})
