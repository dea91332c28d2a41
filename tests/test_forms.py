"""Solvers are recognised by their signature, and an answer that is none is a finding."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kr210_sim.grading.findings import Finding, Refused, Source
from kr210_sim.grading.forms import Caller, recognise

T = np.tile(np.eye(4), (3, 1, 1))
T[:, 0, 3] = 1.0, 2.0, 3.0
QUATERNIONS = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
HOME = np.zeros(6)
ROWS = [[0.1 * joint for joint in range(6)]] * 3


def of_poses(T, q_start): ...
def of_poses_and_options(T, q_start=None, tolerance=1e-9): ...
def of_pose(position, quaternion_xyzw): ...
def of_request(req): ...
def of_request_with_option(req, plot=False): ...


class Node:
    def handle(self, req): ...


def asked(solver) -> list[list[float]]:
    caller = Caller(solver, recognise(solver), Source(Path(__file__), Path(__file__).read_text()))
    return [row for answered in caller.ask(T, QUATERNIONS, HOME) for row in answered.q]


def refused(solver) -> Finding:
    with pytest.raises(Refused) as caught:
        asked(solver)
    return caught.value.finding


@pytest.mark.parametrize(
    ("solver", "form"),
    [
        (of_poses, "poses"),
        (of_poses_and_options, "poses"),
        (lambda T, q0: None, "poses"),
        (lambda *arguments: None, "poses"),
        (of_pose, "pose"),
        (lambda p, quat: None, "pose"),
        (lambda position, orientation: None, "pose"),
        (of_request, "request"),
        (of_request_with_option, "request"),
        (lambda anything: None, "request"),
        (Node().handle, "request"),
        (np.hypot, "poses"),
    ],
)
def test_a_form_is_recognised_by_the_signature(solver, form):
    assert recognise(solver) == form


@pytest.mark.parametrize("solver", [lambda: None, lambda x, y, z: None, 5, None])
def test_other_signatures_are_refused_with_what_is_accepted(solver):
    with pytest.raises(Refused) as caught:
        recognise(solver)
    assert caught.value.finding.kind == "form"


def test_every_form_is_asked_as_agreed():
    seen = []

    def batch(T, q_start):
        seen.append((T.shape, q_start.tolist()))
        return ROWS

    def one(position, quaternion):
        seen.append((position[0], quaternion.tolist()))
        return np.array(ROWS[0])

    def course(req):
        seen.append([(pose.position.x, pose.orientation.w) for pose in req.poses])
        return SimpleNamespace(points=[SimpleNamespace(positions=row) for row in ROWS])

    assert asked(batch) == asked(one) == asked(course) == asked(lambda req: ROWS) == ROWS
    assert seen[0] == ((3, 4, 4), [0.0] * 6)
    assert seen[1:4] == [(x, [0.0, 0.0, 0.0, 1.0]) for x in (1.0, 2.0, 3.0)]
    assert seen[4] == [(x, 1.0) for x in (1.0, 2.0, 3.0)]


def test_what_a_solver_is_given_is_its_own():
    def greedy(T, q_start):
        T[:], q_start[:] = 7.0, 7.0
        return ROWS

    asked(greedy)
    assert T[0, 0, 0] == 1.0
    assert HOME[0] == 0.0


def test_what_foreign_code_raises_is_told_in_one_line_whatever_it_is():
    class Mute(Exception):
        def __str__(self):
            raise RuntimeError

    source = Source(Path("mine.py"), "def solve():\n    return 1 +\n")

    def told(error, **at):
        finding = source.raised(error, **at)
        assert finding.detail.isprintable()
        assert len(finding.detail) <= 300
        return finding.kind, finding.detail, finding.line, finding.source

    assert told(Mute())[:2] == ("raised", "raised Mute: a Mute")
    assert told(MemoryError())[:2] == ("memory", "asked for more memory than it may have")
    assert told(SystemExit(Mute()))[1] == "ended the program by sys.exit(a Mute)"
    assert told(ImportError("no x"))[0] == "import"
    assert told(ImportError("no x"), pose=2)[0] == "raised"
    assert told(ValueError("a\nb\x1b[31m"))[1] == "raised ValueError: a b?[31m"
    assert told(ValueError("x" * 5000))[1].startswith("raised ValueError: xxx")
    wrong = SyntaxError("invalid syntax", ("mine.py", 2, 5, "    return 1 +"))
    assert told(wrong) == ("syntax", "SyntaxError: invalid syntax", 2, "    return 1 +")
    wrong.filename = "other.py"
    assert told(wrong)[2:] == (None, None)


def test_a_row_of_nan_is_no_answer_where_that_is_agreed():
    assert np.isnan(asked(lambda T, q_start: np.full((3, 6), np.nan))).all()
    assert refused(lambda req: np.full((3, 6), np.nan)).kind == "nan"
    assert refused(lambda T, q_start: [[0.0] * 5 + [np.nan]] * 3).kind == "nan"


def test_numbers_of_sympy_and_mpmath_are_numbers():
    sympy, mpmath = pytest.importorskip("sympy"), pytest.importorskip("mpmath")
    row = [sympy.pi, sympy.Float("0.5"), sympy.Rational(1, 4), mpmath.mpf(2), np.float32(1), 3]
    assert asked(lambda req: [row] * 3)[0] == [np.pi, 0.5, 0.25, 2.0, 1.0, 3.0]
    for value in (sympy.sqrt(-1), sympy.acos(2).evalf(), mpmath.mpc(1, 1)):
        assert refused(lambda req, value=value: [[value] * 6] * 3).kind == "complex"
    assert refused(lambda req: [[sympy.Symbol("theta")] * 6] * 3).kind == "not_a_number"


@pytest.mark.parametrize(
    ("answer", "kind"),
    [
        (None, "none"),
        (-1, "shape"),
        ("text", "shape"),
        (ROWS[:2], "shape"),
        ([[0.0] * 5] * 3, "shape"),
        ([None] * 3, "none"),
        ([[None] * 6] * 3, "none"),
        ([[1j] * 6] * 3, "complex"),
        (np.zeros((3, 6)) + 1j, "complex"),
        ([[np.inf] * 6] * 3, "infinite"),
        ([["a"] * 6] * 3, "not_a_number"),
        ([[[]] * 6] * 3, "not_a_number"),
        (SimpleNamespace(points=None), "shape"),
    ],
)
def test_an_answer_that_is_none_is_a_finding_at_the_function(answer, kind):
    def solver(req):
        return answer

    finding = refused(solver)
    assert finding.kind == kind
    assert finding.source.strip() == "def solver(req):"


@pytest.mark.parametrize("error", [ValueError("no"), SystemExit(3), KeyboardInterrupt()])
def test_what_a_solver_raises_is_a_finding_at_its_line(error):
    def solver(req):
        raise error  # here

    finding = refused(solver)
    assert finding.kind == ("exit" if isinstance(error, SystemExit) else "raised")
    assert finding.source.strip() == "raise error  # here"


def test_the_pose_that_fails_is_named():
    def solver(position, quaternion):
        return [1.0] * 6 if position[0] < 2.5 else [1j] * 6

    assert refused(solver).pose == 2


def test_lines_are_counted_as_python_counts_them():
    text = "one\n\f\nthree\u2028still three\n\x0bfour\n"
    source = Source(Path("solver.py"), text)
    assert source.line(4) == "\x0bfour"
    assert [source.line(number) for number in (0, None, 9)] == [None] * 3
