"""Classes of solvers: which files, in what order, taken up again, as table, CSV and page."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from drawn_grades import BRIEF, failed_grade

from kr210_sim.cli import main
from kr210_sim.exceptions import BadInput
from kr210_sim.grading import class_list
from kr210_sim.grading.class_list import find_items, grade_class, open_folder, write_class


@pytest.fixture(scope="module")
def failed(tmp_path_factory, scene):
    return failed_grade(scene, tmp_path_factory.mktemp("solver"))


def test_files_and_folders_make_a_class(tmp_path):
    (tmp_path / "anna").mkdir()
    for name in ("b.py", "_hidden.py", "notes.txt", "anna/IK_server.py"):
        (tmp_path / name).write_text("")
    items = find_items([tmp_path, tmp_path / "b.py"], Path("out"))
    assert [item.name for item in items] == ["anna/IK_server", "b", "b-2"]
    assert items[0].folder == Path("out/anna__IK_server")
    (tmp_path / "anna__IK_server.py").write_text("")
    folders = [item.folder.name for item in find_items([tmp_path], Path("out"))]
    assert folders == ["anna__IK_server", "anna__IK_server-2", "b"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match=r"no \.py files"):
        find_items([tmp_path / "empty"], Path("out"))


def test_a_class_goes_on_where_it_was(tmp_path, monkeypatch, failed):
    seen: list[str] = []

    def fake(source, config):
        seen.append(source.file.name)
        known = {"sha256": class_list.checksum(source), "options": config.as_json()}
        return SimpleNamespace(content=failed | known | {"findings": []})

    for name in "abc":
        (tmp_path / f"{name}.py").write_text(f"{name} = 1\n")
    out = tmp_path / "out"
    monkeypatch.setattr(class_list, "grade", fake)
    items = find_items([tmp_path / f"{name}.py" for name in "abc"], out)
    grade_class(items[:2], BRIEF, jobs=1, on_grade=lambda content: None)
    (tmp_path / "b.py").write_text("b = 2\n")
    told: list[str] = []
    contents = grade_class(
        items, BRIEF, jobs=1, on_grade=lambda content: told.append(content["name"])
    )
    assert seen == ["a.py", "b.py", "b.py", "c.py"]  # b has changed meanwhile
    assert [content["name"] for content in contents] == sorted(told) == ["a", "b", "c"]
    assert (out / "a" / "grade.html").is_file()
    with pytest.raises(BadInput, match="--resume"):
        open_folder(out, resume=False)
    with pytest.raises(BadInput) as caught:
        open_folder(out, resume=False, of_class=False)
    assert "--resume" not in str(caught.value)  # which a single solver does not take


def test_a_solver_that_lacked_a_package_is_graded_again(tmp_path, failed):
    file = tmp_path / "solver.py"
    file.write_text("import sympy\n")
    (item,) = find_items([file], tmp_path)
    same = {"sha256": class_list.checksum(item.source), "options": BRIEF.as_json()}
    for kind, is_finished in (("raised", True), ("import", False)):
        finding = failed["findings"][0] | {"kind": kind}
        class_list.write_grade(item.folder, failed | same | {"findings": [finding]})
        assert (class_list.finished(item, BRIEF) is not None) is is_finished


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["absent.py"], "absent.py"),
        (["nothing"], "kr210-sim: no solver 'nothing'; give FILE.py, FILE.py:FUNC or MODULE:FUNC"),
        (["absent.py:f"], "kr210-sim: absent.py"),
        (["a-b:f"], "kr210-sim: 'a-b'"),
        (["{file}", "--cycles", "0"], "--cycles"),
        (["{file}", "--frame", "tool0"], "--frame"),
        (["{file}", "--ik-scope", "none"], "--ik-scope"),
        (["{file}", "--pose-timeout", "0"], "--pose-timeout"),
        (["{file}", "--time-limit", "nan"], "--time-limit"),
        (["{file}", "--resume"], "--resume"),
        (["{file}", "--resume", "--out", "{file}-out"], "--resume: is for a class"),
        (["{file}", "--debug-cases", "--json"], "--json"),
        (["{file}", "--jobs", "0"], "--jobs"),
        (["{file}", "--debug-cases", "-1"], "--debug-cases"),
        (["{file}", "{file}", "--debug-cases"], "--debug-cases"),
        (["{file}", "--out", "{file}"], "--out"),
    ],
)
def test_bad_input_is_one_line(arguments, text, tmp_path, capsys):
    file = tmp_path / "solver.py"
    file.write_text("")
    assert main(["grade", *(word.replace("{file}", str(file)) for word in arguments)]) == 2
    assert text in capsys.readouterr().err


def test_spreadsheets_get_no_formulas(tmp_path, failed):
    write_class(tmp_path, [failed | {"name": "=cmd()"}], total=1, command="")
    with (tmp_path / "class.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert row["name"] == "'=cmd()"


def test_a_name_that_is_no_text_is_shown_escaped_and_linked(tmp_path, failed):
    name = os.fsdecode(b"caf\xe9")
    write_class(tmp_path, [failed | {"name": name}], total=1, command=f"kr210-sim grade {name}")
    assert r"caf\udce9" in (tmp_path / "class.csv").read_text()
    page = (tmp_path / "class.html").read_text()
    assert r">caf\udce9<" in page
    assert 'href="caf%E9/grade.html"' in page


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_class_that_is_killed_goes_on(tmp_path):
    """Progress is shown, an interrupt says how to go on, and what is graded is not graded again."""
    count = 6
    for index in range(count):
        (tmp_path / f"student_{index}.py").write_text(
            f"import time; time.sleep(0.5)\nx = {index}\n"
        )
    out = tmp_path / "out"
    program = "import sys; from kr210_sim.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program]
    command += ["grade", str(tmp_path), "--cycles", "1", "--jobs", "2", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    for line in process.stdout:
        if line.lstrip().startswith(f"2/{count}"):
            break
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 130, errors
    assert "--resume goes on" in errors
    times = {path: path.stat().st_mtime_ns for path in out.rglob("grade.json")}
    assert 2 <= len(times) < count
    done = subprocess.run([*command, "--resume"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert f"{count}/{count}" in done.stdout
    assert all(path.stat().st_mtime_ns == before for path, before in times.items())
    with (out / "class.csv").open() as file:
        assert len(list(csv.DictReader(file))) == count
    assert f"0 of {count} passed" in (out / "class.html").read_text()
    assert not os.path.exists(out / "class.csv.part")
