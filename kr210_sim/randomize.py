"""What is random in a cycle: quantities, distributions, presets, and files of the same form."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

from kr210_sim.exceptions import BadInput
from kr210_sim.resources import resource

FOLDER = "randomization"
PRESETS = ("course", "nominal", "hard")
MOST_BYTES = 1_000_000  # of a file


@dataclass(frozen=True)
class Fixed:
    """Always the same value, in the unit of the quantity."""

    value: float
    form: ClassVar[str] = "a number"

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return self.value, self.value


@dataclass(frozen=True)
class Uniform:
    """Equally dense between low and high, in the unit of the quantity."""

    low: float
    high: float
    form: ClassVar[str] = "[low, high], low <= high, their difference a float"

    def __post_init__(self) -> None:
        """Check order and width; ValueError otherwise."""
        if not 0 <= self.high - self.low < math.inf:
            raise ValueError

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform:
    """The logarithm equally dense between those of low and high, in the unit of the quantity."""

    low: float
    high: float
    form: ClassVar[str] = "[low, high], 0 < low <= high"

    def __post_init__(self) -> None:
        """Check sign and order; ValueError otherwise."""
        if not 0 < self.low <= self.high:
            raise ValueError

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return self.low, self.high


@dataclass(frozen=True)
class Normal:
    """Gaussian, mean and sigma in the unit of the quantity; without bounds."""

    mean: float
    sigma: float
    form: ClassVar[str] = "[mean, sigma], sigma >= 0"

    def __post_init__(self) -> None:
        """Check the spread; ValueError otherwise."""
        if not self.sigma >= 0:
            raise ValueError

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return (-math.inf, math.inf) if self.sigma else (self.mean, self.mean)


@dataclass(frozen=True)
class Choice:
    """One of some values, each as likely, in the unit of the quantity."""

    values: tuple[float, ...]
    form: ClassVar[str] = "a list of numbers"

    def __init__(self, *values: float) -> None:
        """Take the values; ValueError if there are none."""
        if not values:
            raise ValueError
        object.__setattr__(self, "values", values)

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value."""
        return min(self.values), max(self.values)


Distribution: TypeAlias = Fixed | Uniform | LogUniform | Normal | Choice
FORMS: dict[str, type[Uniform] | type[LogUniform] | type[Normal] | type[Choice]] = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "normal": Normal,
    "choice": Choice,
}


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Something that can be random: the unit is at the end of its name.

    Attributes:
        low, high: values that make sense; nothing outside may be asked for.
        count: how many values are drawn for a cycle.
        whole: whether only whole numbers make sense.
    """

    low: float = -math.inf
    high: float = math.inf
    count: int = 1
    whole: bool = False


QUANTITIES: dict[str, Quantity] = {
    "cell": Quantity(low=1, high=999_999, whole=True),
    "target_x_m": Quantity(low=-1.0, high=1.0),
    "target_y_m": Quantity(low=-1.0, high=1.0),
    "target_yaw_rad": Quantity(low=-2 * math.pi, high=2 * math.pi),
    "target_radius_m": Quantity(low=0.005, high=0.5),
    "target_length_m": Quantity(low=0.02, high=2.0),
    "target_mass_kg": Quantity(low=1e-3, high=1e4),
    "target_com_m": Quantity(low=-0.3, high=0.3),
    "target_friction": Quantity(low=0.01, high=1.0),
    "pad_friction": Quantity(low=0.01, high=1.0),
    "perceived_shift_m": Quantity(count=3),
    "perceived_turn_rad": Quantity(count=3),
    "actuator_gain": Quantity(low=0.5, high=1.5, count=6),
    "actuator_delay_s": Quantity(low=0.0, high=0.05),
    "payload_kg": Quantity(low=0.0, high=1e4),
    "start_rad": Quantity(low=-1.0, high=1.0, count=6),
    "perceived_depth_m": Quantity(),
}
"""In an order that never changes: a quantity's place decides which random stream is its own."""


@dataclass(frozen=True, kw_only=True)
class Randomization:
    """A randomisation block: which quantities are random, and how.

    Attributes:
        name: preset or file, for messages.
        block: quantity -> distribution; what is not named is as without randomisation.
    """

    name: str
    block: Mapping[str, Distribution]

    def bounds(self, name: str) -> tuple[float, float] | None:
        """Return smallest and largest value of a quantity, None if it is not random."""
        return self.block[name].bounds if name in self.block else None

    def as_json(self) -> dict[str, Any]:
        """Return the block in the form of a file, so that a run can be done again without it."""
        names = {form: name for name, form in FORMS.items()}
        return {
            quantity: item.value
            if isinstance(item, Fixed)
            else {
                names[type(item)]: list(item.values if isinstance(item, Choice) else astuple(item))
            }
            for quantity, item in self.block.items()
        }

    def refused(self, name: str, problem: str) -> BadInput:
        """Return the error that names file, field, problem and remedy."""
        return BadInput(f"--randomize: {self.name}: {name}: {problem}")


def read_randomization(name_or_path: str) -> Randomization:
    """Read a preset by name, or a block of the same form from a .toml or .json file.

    Raises:
        BadInput: naming file, field and remedy.
    """
    if name_or_path in PRESETS:
        path = resource("assets", FOLDER, f"{name_or_path}.toml")
    else:
        path = Path(name_or_path)
        if not path.is_file():
            raise BadInput(
                f"--randomize: no preset or file '{name_or_path}'; give {', '.join(PRESETS)} or "
                "the path of a .toml or .json file"
            )
    return make_randomization(name_or_path, _content(name_or_path, path))


def make_randomization(name: str, content: Any) -> Randomization:
    """Check a block and return it.

    Args:
        name: preset or file, for messages.
        content: quantity -> number or {"uniform": [low, high]} and the like.

    Raises:
        BadInput: naming file, field and remedy.
    """
    if not isinstance(content, dict):
        raise BadInput(f"--randomize: {name}: not a table; give one line per quantity")
    block = {}
    for field, value in content.items():
        if field not in QUANTITIES:
            raise BadInput(
                f"--randomize: {name}: {field}: no such quantity; give one of "
                f"{', '.join(QUANTITIES)}"
            )
        block[field] = _distribution(f"--randomize: {name}: {field}", field, value)
    randomization = Randomization(name=name, block=block)
    com, length = randomization.bounds("target_com_m"), randomization.bounds("target_length_m")
    if com is not None and length is not None and max(map(abs, com)) > length[0] / 6:
        raise randomization.refused(
            "target_com_m",
            f"{max(map(abs, com)):g} m is more than a sixth of the shortest target, which no "
            f"density that grows evenly along it gives; give at most {length[0] / 6:.4g}",
        )
    return randomization


def _content(name: str, path: Path) -> Any:
    """Return what a file holds."""
    if path.suffix not in (".toml", ".json"):
        raise BadInput(f"--randomize: {name}: neither .toml nor .json; rename the file")
    if path.stat().st_size > MOST_BYTES:
        raise BadInput(f"--randomize: {name}: larger than {MOST_BYTES} bytes; shorten it")
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        kind = path.suffix[1:].upper()
        raise BadInput(f"--randomize: {name}: not {kind}: {error}; correct the file") from error


def _distribution(where: str, field: str, value: Any) -> Distribution:
    """Return the distribution that a block gives for a quantity."""
    found: Distribution
    if _is_number(value):
        found = Fixed(float(value))
    else:
        if not (isinstance(value, dict) and len(value) == 1 and next(iter(value)) in FORMS):
            raise BadInput(
                f"{where}: {value!r} is no distribution; give a number or a table with one of "
                f"{', '.join(FORMS)}"
            )
        kind, numbers = next(iter(value.items()))
        form = FORMS[kind]
        try:
            if not (isinstance(numbers, list) and all(map(_is_number, numbers))):
                raise ValueError
            found = form(*map(float, numbers))
        except (TypeError, ValueError) as error:
            raise BadInput(
                f"{where}: {kind} = {numbers} is impossible; give {form.form}"
            ) from error
    quantity, (low, high) = QUANTITIES[field], found.bounds
    if not quantity.low <= low <= high <= quantity.high:
        span = f"from {quantity.low:.6g} to {quantity.high:.6g}"
        if not math.isfinite(low):
            raise BadInput(f"{where}: normal is without bounds; give another distribution, {span}")
        raise BadInput(
            f"{where}: {low:g} to {high:g} is beyond what makes sense; give values {span}"
        )
    if quantity.whole:
        values = found.values if isinstance(found, Choice) else (low,) * isinstance(found, Fixed)
        if not values or any(value != int(value) for value in values):
            raise BadInput(f"{where}: only whole numbers make sense; give a number or a choice")
    return found


def _is_number(value: Any) -> bool:
    """Tell whether a value is a finite number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False
