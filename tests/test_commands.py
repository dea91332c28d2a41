"""Every command that the pages show is run: here, by .ci/run, or by the test that is named here.

A command that is new in a page is run here as it stands, unless it is one of those.
"""

from __future__ import annotations

import re
import shlex
import shutil
import socket
import subprocess
import tomllib
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path

import pytest
import test_api
import test_benchmarks
import test_ci_docs
from robot_files import heavy_arm, turned_arm
from shown import PAGES, ROOT, blocks, commands, mentions, my_scene
from test_live import FakeScreen

from kr210_sim.cli import _parser, main
from kr210_sim.grading import grade as grading
from kr210_sim.grading.exercises import EXERCISES
from kr210_sim.verbs import view
from kr210_sim.viewers import native

CI = "\n".join(
    line.replace(" --quiet", "")
    for line in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    if not line.lstrip().startswith(("#", "say "))
)
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
STEPS = {"all", *(exercise.name for exercise in EXERCISES)}
SOLUTION = ROOT / "examples" / "course" / "solution.py"
SHOWN = commands(PAGES)


# ---- where a command is run -----------------------------------------------------------------


def extras_of(command: str) -> set[str]:
    """Return the extras that an installation names, in any spelling of the package."""
    return {name for found in re.findall(r"\[([\w,]+)\]", command) for name in found.split(",")}


def is_run_by_ci(command: str) -> bool:
    """Tell whether .ci/run is this command, has it, or installs its extras, maybe among others."""
    if re.match(r"(python -m )?pip install ", command) and (extras := extras_of(command)):
        installed = (extras_of(line) for line in CI.splitlines() if "pip install" in line)
        return any(extras <= found for found in installed)
    return command == ".ci/run" or re.search(rf"(^|[ /]){re.escape(command)}( |$)", CI, re.M)


def is_run_elsewhere(command: str) -> bool:
    """Tell whether another test runs a command; of a benchmark, minutes long, only its start."""
    words = shlex.split(command)
    if words[0] == "python" and words[1].startswith("benchmarks/"):
        return Path(words[1]).name in test_benchmarks.SCRIPTS
    if "--step" in words and "--json" not in words:  # test_exercises.py takes every step
        return words[words.index("--step") + 1] in STEPS
    return (
        command in map(shlex.join, map(shlex.split, test_ci_docs.COMMANDS))
        or (words[0] == "python" and ROOT / words[1] == test_api.EXAMPLE)
        or words[-1] == "--verify"  # ten cycles: test_replay.py
        or f"{command} --resume" in SHOWN  # run below, before that
    )


RUN_HERE = [line for line in SHOWN if not is_run_by_ci(line) and not is_run_elsewhere(line)]


def test_blocks_say_what_they_are():
    for page in PAGES:
        languages = {language for language, _ in blocks(page)}
        assert languages <= {"", "sh", "text", "python", "xml", "yaml", "toml"}, page.name
    assert len(SHOWN) > 40


def test_what_is_not_run_here_is_run_elsewhere():
    assert all(re.match(r"kr210-sim |python run_cycles\.py|cp ", line) for line in RUN_HERE)


@pytest.mark.parametrize(
    "command",
    ["python -m pip install -e '.[nothing]'", "python -m pytest --no-such", "mkdocs serve",
     "python benchmarks/nothing.py", "kr210-sim grade my_file.py --step nothing", "kr210-sim dh"],
)  # fmt: skip
def test_what_nothing_runs_is_not_taken_for_run(command):
    assert not is_run_by_ci(command)
    assert not is_run_elsewhere(command)


def written_by(command: str) -> set[str]:
    """Return the files and folders that a command makes where it is run, by their names."""
    words = shlex.split(command)
    named = {words[i + 1] for i, word in enumerate(words) if word in ("--out", "-o", "--junit")}
    return named | ({words[-1]} if words[0] in ("cp", "mv") else set())


def test_what_the_commands_write_is_no_change_to_git():
    lines = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    ignored = [line.strip("/") for line in lines if line and not line.startswith("#")]
    written = set().union(*map(written_by, SHOWN))
    assert {"my_file.py", "campaign", "junit.xml", "baseline"} < written
    assert {name for name in written if not any(fnmatch(name, line) for line in ignored)} == set()


# ---- what is named in passing ---------------------------------------------------------------


@pytest.mark.parametrize("page", [p for p in PAGES if mentions(p)], ids=lambda p: p.stem)
def test_commands_named_in_passing_are_there(page, capsys):
    if page.name == "CHANGELOG.md":
        return  # what was
    for command in mentions(page):
        words = shlex.split(command.removesuffix("..."))
        if words[0] == "kr210-sim":
            with pytest.raises(SystemExit) as stop:
                _parser().parse_args([*words[1:], "--help"])
            assert stop.value.code == 0, command
            known = capsys.readouterr().out
            assert all(word in known for word in words if word.startswith("--")), command
        elif words[0] == "python" and words[1] != "-m":
            assert (ROOT / words[1]).is_file() or (page.parent / words[1]).is_file(), command
        assert extras_of(command) <= set(EXTRAS), command


# ---- run here -------------------------------------------------------------------------------


def lay_class(folder: Path) -> None:
    for name in ("anna", "ben"):
        (folder / name).mkdir(parents=True)
        shutil.copy(SOLUTION, folder / name / "my_file.py")


def copied(file: Path) -> Callable[[Path], object]:
    return lambda path: shutil.copy(file, path)


def an_urdf(path: Path) -> None:
    turned_arm(path.parent.resolve()).rename(path)


def a_package(path: Path) -> None:
    made = heavy_arm(Path())
    made.rename(made.with_name(path.name))
    made.parents[1].rename(path.parents[1])  # beside the gripper's package, which it includes


def drawn(page: str) -> Callable[[Path], object]:
    """Return what writes the block of random quantities of a page."""
    (text,) = (text for language, text in blocks(ROOT / "docs" / page) if language == "toml")
    return lambda path: path.write_text(text, encoding="utf-8")


LAID: dict[str, Callable[[Path], object]] = {
    "examples": lambda path: shutil.copytree(ROOT / "examples", path),
    "my_file.py": copied(SOLUTION),
    "my_ik.py": copied(SOLUTION),
    "IK_server.py": copied(ROOT / "tests" / "solvers" / "course" / "old_idioms.py"),
    "class": lay_class,
    "my_arm/urdf/arm.urdf.xacro": a_package,
    "my_arm.urdf.xacro": an_urdf,
    "arm.urdf.xacro": an_urdf,
    "my_block.toml": drawn("randomisation.md"),
    "depth.toml": drawn("retries.md"),
    "my_scene.xml": my_scene,
    "scenes": lambda path: shutil.copytree(ROOT / "scenes", path),
}
"""What the pages take for given, by the name they give it."""


@pytest.fixture
def lay(tmp_path, monkeypatch, scene, default_run) -> Callable[[str], None]:
    """Return lay(command): make what a command names, in an empty folder, and go there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(grading, "_scene", lambda config: scene)

    def made(command: str) -> None:
        runs = {"RUN": default_run.out, "runs/NAME": default_run.out}
        for name, make in LAID.items():
            if re.search(rf" {re.escape(name)}\b", command):
                make(Path(name))
        for name, out in runs.items():
            if f" {name} " not in f"{command} ":
                continue
            if "--map" in command:  # of what is random
                main(["run", "--cycles", "2", "--randomize", "nominal", "--out", name])
            else:
                shutil.copytree(out, name)

    return made


def less(words: list[str]) -> list[str]:
    """Return the words with one cycle and few pictures: the command stays, its minutes do not."""
    given = list(words)
    if "--cycles" in given:
        given[given.index("--cycles") + 1] = "1"
    elif given[0] in ("run", "grade"):  # of the course's goal, half
        given += ["--cycles", "5" if given == ["grade", "my_file.py"] else "1"]
    if "--video" in given or given[0] == "render":
        given += ["--fps", "1", "--size", "160x90"]
    return given


def unattended(words: list[str], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let nobody look: pages close as soon as they are there, and no window is opened."""
    monkeypatch.setattr(view, "until_interrupted", lambda wait: None)
    monkeypatch.setattr(native, "check_display", lambda: None)
    monkeypatch.setattr(native, "NativeScreen", lambda pace: FakeScreen())
    speed = ["--viewer-speed", "20"] if "--viewer" in words else []
    if words[0] != "view" and "web" not in words:
        return speed
    pytest.importorskip("viser", reason="the extra 'view' is not installed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return [*speed, "--port", str(probe.getsockname()[1])]


@pytest.mark.slow
@pytest.mark.parametrize("command", RUN_HERE)
def test_a_command_runs(command, lay, monkeypatch, request):
    lay(command)
    words = shlex.split(command)
    if words[0] == "cp":
        subprocess.run(words, check=True)
        return
    words = ["run", *words[2:]] if words[0] == "python" else words[1:]
    if "--video" in words or words[0] == "render":
        request.getfixturevalue("gl")
    words = less(words) + unattended(words, monkeypatch)
    if "--resume" in words:  # there is a run to go on with
        assert main([word for word in words if word != "--resume"]) == 0
    unsolved = command.endswith("examples/student_ik.py")  # the template, which says so
    unproved = "--confidence" in words  # by one cycle
    hard = "hard" in words or "depth.toml" in words  # a failed cycle is data
    assert main(words) in ({1} if unsolved or unproved else {0, 1} if hard else {0})
