"""The array type of all signatures; shapes, units and frames stand in the docstrings."""

from typing import Any, TypeAlias

from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]
