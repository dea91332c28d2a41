"""What docs/ci.md tells a user to copy works as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from kr210_sim.results import read_lines
from kr210_sim.verbs import common

TEXT = (Path(__file__).parent.parent / "docs" / "ci.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, flags=re.MULTILINE | re.DOTALL)


COMMANDS = [block.strip() for block in blocks("sh")]


def option(command: str, name: str) -> str:
    words = shlex.split(command)
    return words[words.index(name) + 1]


def workflow() -> dict:
    (text,) = blocks("yaml")
    return yaml.safe_load(text)


def test_the_workflow_is_one_and_runs_the_command_of_the_page():
    found = workflow()
    assert set(found) == {"name", True, "jobs"}  # `on` is true in YAML 1.1
    assert set(found[True]) == {"push", "pull_request"}
    (job,) = found["jobs"].values()
    assert set(job) == {"runs-on", "timeout-minutes", "steps"}
    runs = [step["run"] for step in job["steps"] if "run" in step]
    assert runs == ["python -m pip install .", COMMANDS[0]]
    assert all(("run" in step) != ("uses" in step) for step in job["steps"])
    assert all(re.fullmatch(r"actions/[a-z-]+@v\d+", step.get("uses", "actions/x@v1"))
               for step in job["steps"])  # fmt: skip


def test_the_workflow_keeps_what_the_command_writes_whatever_the_gate_says():
    (job,) = workflow()["jobs"].values()
    keep = job["steps"][-1]
    assert keep["if"] == "always()"
    written = [option(COMMANDS[0], "--junit"), option(COMMANDS[0], "--out")]
    assert keep["with"]["path"].split() == written


def test_the_exit_statuses_are_those_of_the_command_line():
    told = {int(code) for code in re.findall(r"^\| (\d+) \|", TEXT, flags=re.MULTILINE)}
    assert told == {value for name, value in vars(common).items() if name.startswith("EXIT_")}


def sh(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a shell that finds what is installed beside this Python."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_the_commands_of_the_page_run_one_after_the_other(tmp_path):
    for command in COMMANDS:
        done = sh(command, tmp_path)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
    lines = list(read_lines(tmp_path / "results"))
    assert len(lines) == 20  # as the page says
    cases = ET.parse(tmp_path / "junit.xml").getroot().findall("testsuite/testcase")
    assert [case.get("name") for case in cases] == [f"cycle_{x['cycle']:04d}" for x in lines]


@pytest.mark.slow
def test_the_pytest_recipe_has_a_test_per_cycle_and_fails_with_the_cycle(tmp_path):
    (recipe,) = blocks("python")
    (tmp_path / "test_cycles.py").write_text(recipe)
    command = "python -m pytest -q -p no:cacheprovider test_cycles.py"
    done = sh(command, tmp_path)
    assert done.returncode == 0, done.stdout
    assert "3 passed" in done.stdout
    broken = recipe.replace("run(config)\n    return list(read_lines(out))", BROKEN)
    assert broken != recipe
    (tmp_path / "test_cycles.py").write_text(broken)
    done = sh(command, tmp_path)
    assert done.returncode == 1
    assert "2 failed, 1 passed" in done.stdout
    assert "dropped in LIFT: it fell" in done.stdout
    assert "kr210-sim run --cycles 3 --seed 1 --only-cycle 2" in done.stdout


BROKEN = """failed = {"reason": "dropped", "failed_stage": "LIFT", "detail": "it fell"}
    return [{"success": cycle == 1} | failed for cycle in range(3)]"""
