"""What a grade looks like: on the terminal, as a page of one solver, as a page of a class."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest
from drawn_grades import drawn_grade, failed_grade
from drawn_runs import SCENERY, make_record, make_run
from pages import HTML, SVG, assert_alone, assert_readable, linked_ids, parsed, section, text_of

from kr210_sim.grading import page
from kr210_sim.grading.class_list import write_class, write_grade
from kr210_sim.grading.grade import GradeConfig
from kr210_sim.grading.page import grade_page
from kr210_sim.grading.report import class_line, grade_text, verdict_text
from kr210_sim.plots.grade_plots import standout_plot
from kr210_sim.report.reading import read_run
from kr210_sim.report.templating import with_code
from kr210_sim.report.write import write_report

ROOT = Path(__file__).parents[1]
MISTAKEN = Path(__file__).parent / "mistaken_solvers.py"


@pytest.fixture(scope="module")
def failed(tmp_path_factory, scene):
    return failed_grade(scene, tmp_path_factory.mktemp("solver"))


@pytest.fixture(scope="module")
def mistaken(scene):
    return drawn_grade(scene, MISTAKEN, "frame_and_turns", GradeConfig(cycles=4, seed=3))


@pytest.fixture(scope="module")
def template(scene):
    return drawn_grade(scene, ROOT / "examples" / "student_ik.py")


@pytest.fixture
def _without_plots(monkeypatch):
    monkeypatch.setattr(page, "_plots", lambda poses, limits: [])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, failed, mistaken, template):
    """A class of three, one of them in a folder of its own."""
    out = tmp_path_factory.mktemp("class")
    contents = [
        failed,
        mistaken | {"name": "anna/IK server"},
        template | {"name": "student_ik"},
    ]
    for content, name in zip(contents, ("evil", "anna__IK server", "student_ik"), strict=True):
        write_grade(out / name, content)
    command = "kr210-sim grade class --out out --resume"
    write_class(out, [contents[0] | {"name": "evil"}, *contents[1:]], total=5, command=command)
    return out


# ---- the terminal ---------------------------------------------------------------------------


def test_a_file_that_fails_at_once_is_reported_with_its_line(failed):
    (finding,) = failed["findings"]
    assert (finding["kind"], finding["line"]) == ("import", 2)
    assert (failed["passed"], failed["succeeded"]) == (False, 0)
    text = grade_text(failed)
    assert "line 2: raised ModuleNotFoundError" in text
    assert "Traceback" not in text
    assert "no_such_package" in class_line(failed)
    json.dumps(failed, allow_nan=False)


def test_a_diagnosis_is_followed_by_what_to_do(mistaken):
    lines = grade_text(mistaken).splitlines()
    (told,) = (n for n, line in enumerate(lines) if "0.193 m behind the pose" in line)
    assert lines[told].startswith("diagnosis")
    assert lines[told + 1].startswith("what to do     Use d7 = 0.303")
    assert "docs/diagnoses.md#tool_length" in lines[told + 1]
    assert any("of cycle 0, move to" in line for line in lines)


@pytest.mark.parametrize(("cycles", "asked_for"), [(1, 1), (2, 2), (5, 4), (10, 8), (12, 10)])
def test_eight_of_ten_are_whole_cycles(cycles, asked_for, failed):
    assert f"({asked_for} asked for;" in verdict_text(failed | {"cycles": cycles})


# ---- the page of a solver -------------------------------------------------------------------


@pytest.mark.parametrize("name", ["evil", "anna__IK server", "student_ik"])
def test_the_page_is_valid_alone_and_readable(folder, name):
    path = folder / name / "grade.html"
    assert_alone(path)
    linked_ids(parsed(path))
    assert_readable(parsed(path), drawings=0 if name == "evil" else 2)


def test_the_verdict_comes_first_then_what_to_do_then_the_plots(folder):
    tree = parsed(folder / "anna__IK server" / "grade.html")
    body = text_of(next(tree.iter(f"{HTML}main")))
    order = ["✗ Not passed", "What to do", "End-effector offset per pose", "Cycles", "Figures"]
    places = [body.index(text) for text in [*order, "Pose by pose", "Grade it again"]]
    assert places == sorted(places)
    assert "0 of 4 cycles succeeded, 4 asked for" in body
    assert "0 of 4 proves a success rate below" in body


def test_a_mistake_stands_there_with_evidence_and_advice(folder):
    text = text_of(section(parsed(folder / "anna__IK server" / "grade.html"), "notes"))
    assert "The wrist center is taken 0.193 m behind the pose instead of 0.303 m" in text
    assert "With that the wrist center is right to 1e-15 m in" in text
    assert "Do: Use d7 = 0.303" in text
    assert text.index("0.193 m") < text.index("Joints make whole turns between neighbouring poses")


def test_a_finding_stands_there_with_its_line_and_no_markup_of_its_own(folder):
    path = folder / "evil" / "grade.html"
    text = text_of(section(parsed(path), "notes"))
    assert "Line 2 of <b>evil.py: raised ModuleNotFoundError" in text
    assert "import no_such_package" in text
    assert "<b>" not in path.read_text()
    assert "No cycle was driven" in path.read_text()


def test_the_template_is_met_with_a_friendly_word(folder):
    text = text_of(section(parsed(folder / "student_ik" / "grade.html"), "notes"))
    assert "Fill it in, step by step" in text
    assert "student_ik.py --cycles 1 --debug-cases" in text


@pytest.mark.usefixtures("_without_plots")
def test_a_right_solver_is_told_that_nothing_is_wrong(scene, tmp_path):
    content = drawn_grade(scene, MISTAKEN, "right")
    assert (content["diagnoses"], content["findings"], content["passed"]) == ([], [], True)
    path = tmp_path / "grade.html"
    path.write_text(grade_page(content))
    assert "Nothing: every answer is right" in text_of(section(parsed(path), "notes"))
    assert "✓ Passed" in text_of(section(parsed(path), "verdict"))


def test_every_pose_has_a_row_and_what_is_wrong_with_it(folder, mistaken):
    found = section(parsed(folder / "anna__IK server" / "grade.html"), "poses")
    rows = [text_of(e) for e in found.iter(f"{HTML}tr") if e.find(f"{HTML}td") is not None]
    assert len(rows) == len(mistaken["poses"]) == 4 * 24
    turned = [row for row in rows if row.endswith("1 needless whole turn.")]
    assert len(turned) == sum(pose["turns"] == 1 for pose in mistaken["poses"]) > 0
    assert rows[0].startswith("0 0.110 ")


def test_page_terminal_diagnosis_and_json_count_the_same_turns(scene, tmp_path):
    """Of turns too far, of two joints at once, and of answers beyond limits."""
    path = tmp_path / "turning.py"
    path.write_text(
        f"import sys; sys.path.insert(0, {str(MISTAKEN.parent)!r})\n"
        "import numpy as np, mistaken_solvers as known\n"
        "def solve(T, q_start):\n"
        "    q = known.right(T, q_start)\n"
        "    turned = q[3:, [3, 5]]\n"
        "    q[3:, [3, 5]] -= 2 * np.pi * np.sign(turned)\n"
        "    q[5, 0] += 4 * np.pi\n"
        "    return q\n"
    )
    content = drawn_grade(scene, path)
    turns = content["figures"]["turns"]
    assert turns == sum(pose["turns"] for pose in content["poses"]) >= 3
    assert max(pose["turns"] for pose in content["poses"]) == 2
    (diagnosis,) = (item for item in content["diagnoses"] if item["key"] == "turn_jumps")
    assert f": {turns} in {len(content['poses'])} steps;" in diagnosis["text"]
    beyond = content["figures"]["beyond_limits"]
    assert beyond >= 2
    joints = f"{beyond} answers beyond limits, 0 branch jumps, {turns} needless whole turns"
    assert joints in grade_text(content)
    written = tmp_path / "grade.html"
    written.write_text(grade_page(content))
    text = " ".join(text_of(parsed(written)).split())
    assert f"change branch, and {turns} whole turns are made that need not be" in text
    assert f"whole turns that need not be {turns} 0" in text
    assert text.count("1 needless whole turn.") + 2 * text.count("2 needless whole turns.") == turns


@pytest.mark.usefixtures("_without_plots")
def test_of_many_cycles_failures_are_shown_first(mistaken, monkeypatch):
    monkeypatch.setattr(page, "MOST_CYCLES", 3)
    results = [line | {"success": line["cycle"] == 2} for line in mistaken["results"]]
    text = grade_page(mistaken | {"results": results})
    assert re.findall(r"Cycle (\d) <span>· move to pick", text) == ["0", "1", "3"]
    assert "24 poses of further cycles are neither here nor in the plots" in text


def test_the_command_grades_it_again(folder, mistaken):
    command = page.grade_command([mistaken["solver"]], mistaken["options"])
    words = shlex.split(command)
    assert words[:2] == ["kr210-sim", "grade"]
    assert Path(words[2]).name == "mistaken_solvers.py:frame_and_turns"
    assert words[3:] == ["--cycles", "4", "--seed", "3"]
    assert command in (folder / "anna__IK server" / "grade.html").read_text()


@pytest.mark.usefixtures("_without_plots")
def test_poses_without_an_answer_are_marked(mistaken):
    request = ("cycle", "stage", "pose", "position_m")
    poses = [
        {key: pose[key] for key in request} | {"q_rad": None} if pose["pose"] > 5 else pose
        for pose in mistaken["poses"]
    ]
    text = grade_page(mistaken | {"poses": poses})
    assert text.count("no answer</td>") == 4 * 2 * 6
    assert "48 have no answer" in standout_plot(poses).alt


def test_all_pages_share_one_look(folder, tmp_path):
    make_run(tmp_path / "run", [make_record(0)])
    report = write_report(read_run(tmp_path / "run"), SCENERY).read_text()
    styles = {
        text[text.index("<style>") : text.index("</style>")]
        for text in (
            report,
            (folder / "class.html").read_text(),
            (folder / "evil" / "grade.html").read_text(),
        )
    }
    assert len(styles) == 1


# ---- the page of a class --------------------------------------------------------------------


def test_the_page_of_a_class_leads_to_every_solver(folder):
    path = folder / "class.html"
    links = {"evil/grade.html", "anna__IK%20server/grade.html", "student_ik/grade.html"}
    assert_alone(path, links=frozenset(links))
    assert_readable(parsed(path), drawings=0)
    assert links <= {e.get("href") for e in parsed(path).iter(f"{HTML}a")}
    assert not list(parsed(path).iter(f"{SVG}svg"))


def test_the_page_of_a_class_tells_the_teacher_what_to_teach(folder):
    tree = parsed(folder / "class.html")
    assert "0 of 5 passed 3 of 5 solvers graded" in text_of(section(tree, "verdict"))
    mistakes = text_of(section(tree, "mistakes"))
    assert "tool length 1 Use d7 = 0.303" in mistakes
    assert "import 1" in mistakes
    solvers = text_of(section(tree, "solvers"))
    assert "(1 more)" in solvers
    assert "Unsolved: every pose got the same answer" in solvers
    assert "Go on kr210-sim grade class" in text_of(section(tree, "configuration"))


def test_backticks_are_code_and_nothing_else_is_markup():
    assert with_code("take `a < b` & c") == "take <code>a &lt; b</code> &amp; c"
    assert with_code("one ` alone") == "one ` alone"
