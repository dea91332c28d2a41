"""The forms of a solver: recognised by its signature, called, and held to its answer."""

from __future__ import annotations

import contextlib
import inspect
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kr210_sim.arrays import Array
from kr210_sim.grading.findings import Finding, Refused, Source
from kr210_sim.grading.stand_ins.services import calculate_ik_request

FORMS = {
    "poses": "f(T_base_gripper_link (N, 4, 4), q_start (6,)) -> (N, 6)",
    "pose": "f(position (3,), quaternion_xyzw (4,)) -> six angles",
    "request": "f(req) with req.poses[i], -> points[i].positions",
}
"""The forms that are accepted."""

MOST_NUMBERS = 10_000
"""In the answer of an exercise's function; the largest right one has a few hundred."""

_ABOUT_ORIENTATION = ("quat", "orient", "rot")


@dataclass(frozen=True, kw_only=True)
class Answered:
    """Rows of an answer.

    Attributes:
        q: (n, 6) the angles [rad], a row of NaN for no answer.
        seconds: per pose [s].
    """

    q: list[list[float]]
    seconds: float


def recognise(solver: Any) -> str:
    """Return the form of a solver by its signature.

    One parameter without a default is the course's request, two are poses and q_start, or position
    and quaternion if the second is named after an orientation. A compiled function without a
    signature takes poses and q_start.

    Raises:
        Refused: if it is none of them.
    """
    if not callable(solver):
        raise Refused(Finding(kind="form", detail=f"is a {type(solver).__name__}, no function"))
    try:
        parameters = list(inspect.signature(solver).parameters.values())
    except (TypeError, ValueError):
        return "poses"
    positional = [
        parameter
        for parameter in parameters
        if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    ]
    needed = [parameter for parameter in positional if parameter.default is parameter.empty]
    any_number = any(parameter.kind is parameter.VAR_POSITIONAL for parameter in parameters)
    if len(positional) >= 2 and len(needed) in (1, 2) and not _is_request(positional[0].name):
        named = positional[1].name.lower()
        is_one = named.startswith(_ABOUT_ORIENTATION) or named == "q_xyzw"
        return "pose" if is_one else "poses"
    if len(needed) == 1 or (not needed and len(positional) == 1):
        return "request"
    if any_number and not needed:
        return "poses"
    raise Refused(
        Finding(
            kind="form",
            detail=f"takes {len(needed)} arguments; accepted are {'; '.join(FORMS.values())}",
            line=first_line(solver),
        )
    )


def _is_request(name: str) -> bool:
    return name.lower().startswith("req")


def first_line(solver: Any) -> int | None:
    """Return where a function begins in its source."""
    code = getattr(getattr(solver, "__func__", solver), "__code__", None)
    return getattr(code, "co_firstlineno", None)


class Caller:
    """Asks a solver in its form.

    Args:
        solver: the function.
        form: one of FORMS.
        source: where it is from.
    """

    def __init__(self, solver: Callable[..., Any], form: str, source: Source) -> None:
        self._solver, self.form, self._source = solver, form, source

    def ask(self, T: Array, quaternions: Array, q_start: Array) -> Iterator[Answered]:
        """Yield the answers in order: all at once, or pose by pose.

        Args:
            T: (N, 4, 4) the poses.
            quaternions: (N, 4) their orientations, xyzw.
            q_start: (6,) where the arm stands [rad].

        Raises:
            Refused: if the solver raises or its answer is none.
        """
        if self.form == "pose":
            for index, (pose, quaternion) in enumerate(zip(T, quaternions, strict=True)):
                answer, seconds = self._call(index, pose[:3, 3].copy(), quaternion.copy())
                row = self._row(answer, index)
                yield Answered(q=[row], seconds=seconds)
            return
        if self.form == "poses":
            answer, seconds = self._call(None, T.copy(), q_start.copy())
            rows = self._matrix(answer, len(T))
        else:
            request = calculate_ik_request(T[:, :3, 3].tolist(), quaternions.tolist())
            answer, seconds = self._call(None, request)
            rows = self._points(answer, len(T))
        yield Answered(q=rows, seconds=seconds / max(1, len(T)))

    def values(self, arguments: Sequence[Any]) -> list[Any]:
        """Return the numbers that a function of an exercise answers, nested as an array is.

        Args:
            arguments: one per parameter; lists become arrays.

        Raises:
            Refused: if it takes other arguments, raises, or answers no numbers.
        """
        given = [np.array(value) if isinstance(value, list) else value for value in arguments]
        with contextlib.suppress(ValueError):  # a compiled function without a signature
            try:
                inspect.signature(self._solver).bind(*given)
            except TypeError as error:
                count = f"{len(given)} argument" + ("s" if len(given) != 1 else "")
                raise self._refuse("form", f"does not take {count}") from error
        answer, _ = self._call(None, *given)
        if answer is None:
            raise self._refuse("none", "answered None")
        try:
            cells = np.atleast_1d(np.asarray(answer, dtype=object))
        except Exception as error:
            what = type(answer).__name__
            raise self._refuse("shape", f"answered a {what}, no array of numbers") from error
        if cells.size > MOST_NUMBERS:
            raise self._refuse("shape", f"answered {cells.size} numbers")
        found: Array = np.empty(cells.shape)
        for index, value in np.ndenumerate(cells):
            where = "[" + ", ".join(map(str, index)) + "]"
            found[index] = self._number(value, f"entry {where} of the answer", None)
            if not math.isfinite(found[index]):
                raise self._refuse("nan", f"entry {where} of the answer is {found[index]}")
        nested: list[Any] = found.tolist()
        return nested

    def _call(self, pose: int | None, *arguments: Any) -> tuple[Any, float]:
        started = time.perf_counter()
        try:
            answer = self._solver(*arguments)
        except BaseException as error:  # whatever foreign code raises is a finding
            raise Refused(self._source.raised(error, pose=pose)) from error
        return answer, time.perf_counter() - started

    def _refuse(self, kind: str, detail: str, pose: int | None = None) -> Refused:
        line = first_line(self._solver)
        source = self._source.line(line)
        return Refused(Finding(kind=kind, detail=detail, line=line, source=source, pose=pose))

    def _matrix(self, answer: Any, count: int) -> list[list[float]]:
        """Return the rows of an answer to all poses; a row of NaN is allowed, it is no answer."""
        if answer is None:
            raise self._refuse("none", "answered None")
        rows = self._sequence(answer, f"a list of {count} rows", None)
        if len(rows) != count:
            raise self._refuse("shape", f"answered {len(rows)} rows to {count} poses")
        return [self._row(row, index, nan=True) for index, row in enumerate(rows)]

    def _points(self, answer: Any, count: int) -> list[list[float]]:
        if answer is None:
            raise self._refuse("none", "answered None")
        points = getattr(answer, "points", answer)
        if isinstance(points, int) and not isinstance(points, bool):
            raise self._refuse("shape", f"answered {points} instead of points")
        points = self._sequence(points, "a response with points", None)
        if len(points) != count:
            raise self._refuse("shape", f"answered {len(points)} points to {count} poses")
        return [
            self._row(getattr(point, "positions", point), index)
            for index, point in enumerate(points)
        ]

    def _sequence(self, values: Any, wanted: str, pose: int | None) -> list[Any]:
        try:
            found = list(values)
        except Exception as error:
            what = type(values).__name__
            raise self._refuse("shape", f"answered a {what}, not {wanted}", pose) from error
        return found

    def _row(self, values: Any, pose: int, *, nan: bool = False) -> list[float]:
        if values is None:
            raise self._refuse("none", f"answered None to pose {pose}", pose)
        angles = self._sequence(values, "six angles", pose)
        if len(angles) != 6:
            raise self._refuse("shape", f"answered {len(angles)} angles to pose {pose}", pose)
        row = [
            self._number(value, f"theta {joint} of pose {pose}", pose)
            for joint, value in enumerate(angles, start=1)
        ]
        if nan and all(map(math.isnan, row)):
            return row
        for joint, value in enumerate(row, start=1):
            if not math.isfinite(value):
                kind = "nan" if math.isnan(value) else "infinite"
                raise self._refuse(kind, f"theta {joint} of pose {pose} is {value}", pose)
        return row

    def _number(self, value: Any, where: str, pose: int | None) -> float:
        """Return a float of whatever kind of number: sympy's, mpmath's, NumPy's.

        Raises:
            Refused: if it is none, or complex.
        """
        if value is None:
            raise self._refuse("none", f"{where} is None", pose)
        if isinstance(value, np.ndarray) and value.size == 1:
            value = value.reshape(())[()]
        try:
            if not isinstance(value, complex | np.complexfloating):
                return float(value)
        except Exception as error:
            if not _is_complex(value):
                detail = f"{where} is no number but a {type(value).__name__}: {str(value)[:60]}"
                raise self._refuse("not_a_number", detail, pose) from error
        raise self._refuse("complex", f"{where} is complex: {str(value)[:60]}", pose)


def _is_complex(value: Any) -> bool:
    try:
        complex(value)
    except Exception:  # foreign numbers may fail at anything
        return False
    return True
