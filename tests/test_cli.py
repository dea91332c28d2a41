"""The command line: exit statuses, one clear line for bad input, and nothing written by it."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

import kr210_sim.summary
from kr210_sim import __version__
from kr210_sim.cli import main
from kr210_sim.resources import resource

ROOT = Path(__file__).parent.parent


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """An empty working folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def write_hasty_scene(folder: Path) -> str:
    """Write the bundled scene with a time limit that no cycle can keep."""
    text = resource("scenes", "shelf_and_bin.xml").read_text()
    path = folder / "hasty.xml"
    path.write_text(text.replace('"time_limit" data="60"', '"time_limit" data="0.05"'))
    return str(path)


# ---- bad input ------------------------------------------------------------------------------

BAD = [
    ("--min-success", "1.01"), ("--min-success", "-0.1"), ("--min-success", "nan"),
    ("--max-ik-offset", "0"), ("--max-ik-offset", "nan"), ("--max-ik-offset", "-1"),
    ("--max-cycle-time", "0"), ("--max-cycle-time", "inf"), ("--max-cycle-time", "soon"),
    ("--confidence", "0.5"), ("--confidence", "1"), ("--confidence", "nan"), ("--confidence", "x"),
    ("--indifference", "0.1"), ("--only-cycle", "10"), ("--only-cycle", "-1"),
    ("--cell", "12"), ("--cell", "0"), ("--cell", "-1"), ("--cell", "1.5"), ("--cell", "middle"),
    ("--cell", "9" * 5000), ("--cell", "\u0665"),
    ("--robot", "nothing.xacro"), ("--robot", "."), ("--robot", ""),
    ("--mass", "-1"), ("--mass", "0"), ("--mass", "nan"), ("--mass", "inf"), ("--mass", "1e9"),
    ("--mass", "17"), ("--mass", "1e-300"), ("--mass", "heavy"),
    ("--clearance", "-0.01"), ("--clearance", "0.11"), ("--clearance", "nan"),
    ("--speed", "0"), ("--speed", "1.5"), ("--speed", "-1"), ("--speed", "nan"),
    ("--cycles", "0"), ("--cycles", "-3"), ("--cycles", "x"), ("--cycles", "1.5"),
    ("--cycles", "99999999999999999999"),
    ("--seed", "-1"), ("--seed", "x"),
    ("--scene", "nosuch"), ("--scene", ""), ("--scene", "."),
    ("--ik", "nosuch"), ("--frame", "tool0"), ("--ik-scope", "some"), ("--ik-scope", "none"),
    ("--episode-cycles", "0"), ("--jobs", "0"), ("--backend", "spark"), ("--record", "some"),
    ("--viewer", "tv"), ("--retries", "-1"),
    ("--out", "n" * 300), ("--video", "film.txt"), ("--video", "nowhere/film.mp4"),
]  # fmt: skip


@pytest.mark.parametrize(("option", "value"), BAD, ids=[f"{o} {v[:12]}" for o, v in BAD])
def test_bad_input_is_refused_in_one_line_and_nothing_is_written(here, capfd, option, value):
    status = main(["run", option, value])
    out, err = capfd.readouterr()
    assert status == 2, err
    assert out == ""
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert option in err
    assert "Traceback" not in err
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["--resume"], "--resume"),
        (["--cell", "all", "--episode-cycles", "2"], "--episode-cycles"),
        (["--record", "none", "--video", "film.mp4"], "--record"),
        (["--viewer", "web", "--jobs", "2"], "--viewer"),
        (["--only-cycle", "1", "--resume", "--out", "run"], "--only-cycle"),
        (["--size", "64x64"], "--video"),
        (["--out", "run", "--junit", "run"], "--junit"),
    ],
)
def test_options_that_do_not_go_together_are_refused_in_one_line(here, capfd, arguments, option):
    assert main(["run", *arguments]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith(f"kr210-sim: {option}: ")
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--bogus"],
        ["run", "--cycl", "3"],
        ["run", "stray"],
        ["run", "--mass"],
        ["run", "--cell=--"],
        ["nosuch"],
        [],
    ],
)
def test_an_unknown_or_incomplete_option_is_refused_in_one_line(here, capfd, arguments):
    status = main(arguments)
    out, err = capfd.readouterr()
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "--randomize", "9" * 400],
        ["run", "--out", "9" * 400],
        ["run", "--junit", "9" * 400],
        ["report", "9" * 400],
        ["compare", "9" * 400, "b"],
        ["grade", "9" * 400],
    ],
    ids=lambda arguments: " ".join(arguments[:-1])[:20],
)
def test_a_name_too_long_for_a_file_is_refused_in_one_line(here, capfd, arguments):
    assert main(arguments) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert "too long" in error
    assert not any(here.iterdir())


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["run", "--cycels", "3"], "--cycles?"),
        (["run", "--randomise=nominal"], "--randomize?"),
        (["grade", "ik.py", "--setp", "rotation"], "--step?"),
        (["run", "stray"], "--help"),
        (["run", "--helpp"], "did you mean --help?"),
        (["--helpp"], "did you mean --help?"),
        (["rnu", "--cycles", "3"], "did you mean run?"),
        (["compere", "a", "b"], "did you mean compare?"),
        (["xyzzy"], "give one of run, report,"),
        ([], "--help"),
        (["run", "--mass", "1kg"], "--mass: '1kg' is no number; give one"),
        (
            ["run", "--ik", "my_ik.py"],
            "--ik: 'my_ik.py' needs its function: give it as FILE.py:FUNC",
        ),
        (["run", "--mass"], "--mass: its value is missing; give one"),
        (["ik", "--position", "1", "2"], "--position: give 3 values"),
        (
            ["run", "--config", "my.toml"],
            "(No such file or directory); give a .toml",
        ),
    ],
)
def test_what_is_mistyped_is_told_with_what_was_meant(here, capfd, arguments, remedy):
    assert main(arguments) == 2
    assert remedy in capfd.readouterr().err


def test_the_package_runs_as_a_module(here):
    done = subprocess.run(
        [sys.executable, "-m", "kr210_sim", "run", "--list-scenes"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "shelf_and_bin" in done.stdout.splitlines()


def test_a_folder_that_is_not_empty_is_not_written_to(here, capfd):
    (here / "full").mkdir()
    (here / "full" / "thesis.txt").write_text("precious")
    assert main(["run", "--out", "full"]) == 2
    err = capfd.readouterr().err
    assert "--out" in err
    assert err.count("\n") == 1
    assert [path.name for path in (here / "full").iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize("out", ["file", "file/below", "file/further/below"])
def test_a_file_is_no_folder_to_write_to(here, capfd, out):
    (here / "file").write_text("precious")
    assert main(["run", "--out", out]) == 2
    err = capfd.readouterr().err
    assert "--out" in err
    assert err.count("\n") == 1
    assert (here / "file").read_text() == "precious"


def test_the_door_is_the_verb_run_and_has_no_traceback_for_bad_input(here):
    done = subprocess.run(
        [sys.executable, str(ROOT / "run_cycles.py"), "--mass", "nan"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "--mass" in done.stderr


@pytest.mark.parametrize("broken", ["scene", "robot"])
def test_a_broken_file_is_refused_by_its_name(here, capfd, broken):
    (here / "broken.xml").write_text("<mujoco")
    assert main(["run", f"--{broken}", "broken.xml"]) == 2
    err = capfd.readouterr().err
    assert "broken.xml" in err
    assert err.count("\n") == 1
    assert [path.name for path in here.iterdir()] == ["broken.xml"]


# ---- runs -----------------------------------------------------------------------------------


def test_a_run_that_passes_exits_with_0_and_shows_its_table(here, capfd):
    assert main(["run", "--cycles", "1", "--cell", "5", "--out", "results/first"]) == 0
    out, err = capfd.readouterr()
    assert "1 of 1 cycles succeeded" in out
    assert out.endswith("exit status 0: all gates met\n")
    assert "results/first" in out
    assert "\x1b" not in out + err
    assert json.loads((here / "results" / "first" / "summary.json").read_text())["passed"]
    assert {path.name for path in here.iterdir()} == {"results"}


def test_a_run_below_its_gate_exits_with_1_and_json_is_alone_on_stdout(here, capfd):
    scene = write_hasty_scene(here)
    status = main(["run", "--cycles", "2", "--scene", scene, "--out", "run", "--json"])
    out, err = capfd.readouterr()
    assert status == 1
    summary = json.loads(out)
    assert summary == json.loads((here / "run" / "summary.json").read_text())
    assert summary["failures"] == {"timeout": 2}
    assert "timeout" in err
    assert {path.name for path in here.iterdir()} == {"run", "hasty.xml"}


def test_a_gate_of_nothing_is_passed_by_failures(here, capfd):
    scene = write_hasty_scene(here)
    arguments = ["--cycles", "1", "--scene", scene, "--out", "run", "--min-success", "0"]
    assert main(["run", *arguments]) == 0
    assert "0 of 1" in capfd.readouterr().out


def test_an_interrupted_run_exits_with_130_and_keeps_what_is_finished(here, capfd, monkeypatch):
    real = kr210_sim.summary.cycle_line
    shown: list[int] = []

    def interrupted(line):
        shown.append(line["cycle"])
        if len(shown) == 2:
            raise KeyboardInterrupt
        return real(line)

    monkeypatch.setattr(kr210_sim.summary, "cycle_line", interrupted)
    scene = write_hasty_scene(here)
    assert main(["run", "--cycles", "5", "--scene", scene, "--out", "my run"]) == 130
    err = capfd.readouterr().err
    assert err.count("\n") == 1
    assert "interrupted" in err
    assert "--out 'my run' --resume" in err
    assert len((here / "my run" / "cycles.jsonl").read_text().splitlines()) == 2


def test_a_disk_that_is_full_exits_with_3(here, capfd, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("kr210_sim.episode_files.save_record", full)
    scene = write_hasty_scene(here)
    assert main(["run", "--cycles", "1", "--scene", scene, "--out", "run"]) == 3
    err = capfd.readouterr().err
    assert "No space left" in err
    assert "Traceback" not in err


def test_an_error_of_ours_exits_with_3_and_says_so(here, capfd, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("kr210_sim.runner.load_world", broken)
    assert main(["run", "--cycles", "1"]) == 3
    err = capfd.readouterr().err
    assert "ZeroDivisionError" in err
    assert "internal error" in err


def test_a_reader_that_has_gone_is_no_error_to_tell_of(here, capfd, monkeypatch):
    class Gone(io.StringIO):
        def write(self, _text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stdout", Gone())
    assert main(["run", "--list-scenes"]) == 3
    assert capfd.readouterr() == ("", "")


def test_without_an_output_it_runs_all_the_same(here, monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["run", "--list-scenes"]) == 0
    assert main(["run", "--cycles", "0"]) == 2


# ---- information ----------------------------------------------------------------------------


def test_the_version_names_what_decides_the_numbers(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert __version__ in out
    assert "MuJoCo" in out
    assert "ruckig" in out


def test_scenes_are_listed_one_a_line(capsys):
    assert main(["run", "--list-scenes"]) == 0
    assert "shelf_and_bin" in capsys.readouterr().out.splitlines()


def test_the_help_of_run_names_every_option_with_its_default(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["run", "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    for option in (
        "--cycles", "--seed", "--scene", "--robot", "--cell", "--mass", "--speed",
        "--clearance", "--ik", "--min-success", "--confidence", "--stop-early",
        "--indifference", "--only-cycle", "--out", "--json", "--video", "--list-scenes",
    ):  # fmt: skip
        assert option in text
    assert "(default: 10)" in text
    assert "130" in text
