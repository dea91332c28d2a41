"""The command `grade --step`: bad input in a line, functions in a process of their own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kr210_sim.cli import main
from kr210_sim.exceptions import BadInput
from kr210_sim.grading import exercises
from kr210_sim.grading.exercises import find_exercises
from kr210_sim.grading.findings import Refused
from kr210_sim.grading.source import SolverLimits

COURSE = Path(__file__).parents[1] / "examples" / "course"


def test_an_unknown_step_is_refused_with_those_there_are():
    with pytest.raises(BadInput, match="wrist_center"):
        find_exercises("wrist")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["solution.py", "--step", "nope"], "--step: no step 'nope'"),
        (["solution.py:solve", "--step", "solve"], "leave ':solve' out"),
        (["solution.py", "--step", "solve", "--debug-cases"], "not both"),
        (["solution.py", "exercises.py", "--step", "solve"], "--step: is for one solver"),
    ],
)
def test_bad_input_is_one_line(arguments, text, monkeypatch, capsys):
    monkeypatch.chdir(COURSE)
    assert main(["grade", *arguments]) == 2
    assert text in capsys.readouterr().err


STEPS = """
import os, time
def wrist_center(T_0_7):
    open({outside!r}, "w")
def first_three(center):
    os._exit(3)
def last_three(theta1, theta2, theta3, T_0_7):
    while True:
        pass
def dh_table():
    return [[0.0] * 4] * 3000
def transform(alpha, a, d, theta):
    print("alpha is", alpha, "\\x1b[2J")
"""


@pytest.mark.slow
def test_a_hostile_function_is_held_to_its_process(tmp_path, capsys):
    outside = tmp_path / "outside"
    mine = tmp_path / "mine.py"
    mine.write_text(STEPS.format(outside=str(outside)))
    for name, text in {
        "wrist_center": "raised PermissionError",
        "first_three": "ended itself with status 3",
        "last_three": "no answer to a case within 1 s",
        "dh_table": "answered 12000 numbers",
        "transform": "  it printed alpha is 0.0 ?[2J",
        "dh_pose": "there is no function dh_pose; it has dh_table, first_three",
    }.items():
        patience = "1" if name == "last_three" else "30"
        assert main(["grade", str(mine), "--step", name, "--pose-timeout", patience]) == 1
        assert text in capsys.readouterr().out
    assert not outside.exists()


@pytest.mark.slow
def test_a_step_in_a_process_of_its_own(capsys):
    assert main(["grade", str(COURSE / "solution.py"), "--step", "wrist_center", "--json"]) == 0
    printed = capsys.readouterr()
    (step,) = json.loads(printed.out)
    assert (step["step"], step["passed"], step["right"]) == ("wrist_center", True, step["cases"])
    assert "wrist_center: right in" in printed.err
    assert main(["grade", str(COURSE / "exercises.py"), "--step", "transform"]) == 1
    assert "not written yet" in capsys.readouterr().out


def test_an_answer_that_is_none_is_refused(robot):
    class Silent(exercises.FunctionProcess):
        def __init__(self, message):
            self.message, self._limits = message, SolverLimits()

        def _send(self, message): ...

        def _receive(self, allowed, what):
            return self.message

        def _drain_now(self): ...

        def _lost(self, detail, **more):
            return super()._lost(detail)

        def _kill(self): ...

    for message in ({}, {"values": "x"}, {"values": [[1], [1, 2]]}, {"values": []},
                    {"values": [float("inf")]}, {"values": {}}):  # fmt: skip
        with pytest.raises(Refused):
            Silent({"event": "values"} | message).call(())
