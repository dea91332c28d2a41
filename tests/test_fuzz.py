"""Options and files that nobody would write: each is taken or refused in one line, none crashes.

`FUZZ_EXAMPLES=3000 python -m pytest -m slow tests/test_fuzz.py` takes about 20 minutes and draws
anew each time; by default there are few examples, always the same.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from drawn_runs import DROPPED, make_record, make_run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kr210_sim.api import load_run
from kr210_sim.cli import main
from kr210_sim.compare import compare_runs
from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.loading import load_robot
from kr210_sim.options import read_options
from kr210_sim.randomize import read_randomization
from kr210_sim.report.reading import read_run
from kr210_sim.resources import resource
from kr210_sim.scene import build_scene
from kr210_sim.source import RobotSource

pytestmark = pytest.mark.slow

ASKED = os.environ.get("FUZZ_EXAMPLES")
FEW = int(ASKED or 40)


def fuzz(share: float = 1.0) -> Callable[..., object]:
    """Settings of a test that gets a share of the examples."""
    return settings(
        max_examples=max(1, int(share * FEW)),
        deadline=None,
        derandomize=ASKED is None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


# ---- what is drawn --------------------------------------------------------------------------

ODD = [
    *("", " ", "nan", "-inf", "1e999", "-0", "0", "1", "-1", "1e-320", "9" * 400, "٣", "0x10"),
    *("1_0", "true", "null", "[]", "{}", "--", "-", "all", "random", "/", "..", "/dev/null", "="),
    *("a=b", "x:y", "f.py:g", "é", "\udcff", "%s", "{0}", "a,b", "1x1", "99999x99999", "web"),
]
WORDS = st.one_of(
    st.sampled_from(ODD),
    st.integers().map(str),
    st.floats().map(str),
    st.text(st.characters(exclude_characters="\0"), max_size=30),
)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=5,
)
TOKENS = [
    *(
        '"',
        "<",
        ">",
        "/>",
        "=",
        "[",
        "{",
        "}",
        "]",
        ",",
        "\n",
        "\0",
        "é",
        "-",
        "&a;",
        "<!--",
        "]]>",
    ),
    *("1e400", "nan", "0", "-1", "1e-300", "null"),
]


@st.composite
def mutated(draw: st.DrawFn, text: str) -> bytes:
    """A text with some of it lost, doubled, replaced, or cut off."""
    content = text
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(content) - 1)))
        to = min(len(content), at + draw(st.integers(0, 40)))
        match draw(st.integers(0, 4)):
            case 0:
                content = content[:at] + content[to:]
            case 1:
                content = content[:to] + content[at:]
            case 2:
                content = content[:at] + draw(st.sampled_from(TOKENS)) + content[to:]
            case 3:
                content = content[:at]
            case 4:
                content = _number_changed(draw, content, at)
    raw = content.encode()
    return raw + draw(st.binary(max_size=3)) if draw(st.integers(0, 9)) == 0 else raw


def _number_changed(draw: st.DrawFn, text: str, at: int) -> str:
    """The next number behind a place becomes another."""
    start = next((i for i in range(at, len(text)) if text[i].isdigit()), len(text))
    end = next((i for i in range(start, len(text)) if text[i] not in "0123456789.e-"), len(text))
    number = draw(st.sampled_from(["0", "-1", "1e9", "1e-9", "1e308", "nan", "inf", "7", "0.5"]))
    return text[:start] + number + text[end:]


@st.composite
def changed(draw: st.DrawFn, content: object) -> object:
    """A JSON value of which one part, somewhere, is gone or another one."""
    if isinstance(content, dict) and content and draw(st.integers(0, 4)):
        key = draw(st.sampled_from(sorted(content)))
        rest = {name: value for name, value in content.items() if name != key}
        return rest if draw(st.integers(0, 5)) == 0 else rest | {key: draw(changed(content[key]))}
    if isinstance(content, list) and content and draw(st.integers(0, 4)):
        at = draw(st.integers(0, len(content) - 1))
        return [*content[:at], draw(changed(content[at])), *content[at + 1 :]]
    return draw(VALUES)


def taken_or_refused(use: Callable[[], object]) -> None:
    """Fail unless a use of bad input succeeds or is refused."""
    with contextlib.suppress(BadInput):
        use()


# ---- options --------------------------------------------------------------------------------

# what writes files, opens a page or looks for a display is not asked for
RUN_OPTIONS = sorted(RunConfig.metadata().keys() - {"video", "junit", "out", "resume", "viewer"})
RUN_PAIRS = st.lists(st.tuples(st.sampled_from(RUN_OPTIONS), WORDS), min_size=1, max_size=4)


@given(pairs=RUN_PAIRS)
@fuzz(4)
def test_any_options_of_run_are_taken_or_refused_in_one_line(pairs):
    arguments = ["run"]
    for name, value in pairs:
        flag = RunConfig.metadata()[name][1]["kind"] is bool
        option = "--" + name.replace("_", "-")
        arguments.append(option if flag else f"{option}={value}")
    _one_line(arguments)


@given(arguments=st.lists(WORDS | st.sampled_from(["--position", "--quaternion", "--json"])))
@fuzz(1)
@pytest.mark.parametrize("verb", ["ik", "report", "render", "compare", "grade", "convert", "view"])
def test_any_words_behind_a_verb_are_refused_in_one_line(verb, arguments):
    _one_line([verb, *arguments, "--no-such-option"])


def _one_line(arguments: list[str]) -> None:
    """Give a command line to `main`, short of playing cycles, and look at what it says."""

    def played(*_given: object, **_named: object) -> None:
        raise BadInput("taken")

    said = tempfile.SpooledTemporaryFile(mode="w+", encoding="utf-8", errors="backslashreplace")
    with pytest.MonkeyPatch.context() as patch, said, contextlib.redirect_stderr(said):
        patch.setattr("kr210_sim.runner.run", played)
        with contextlib.redirect_stdout(said):
            try:
                status = main(arguments)
            except SystemExit as stop:  # of --help or --version among the words
                status = 2 if stop.code == 0 else stop.code
        said.seek(0)
        text = said.read()
    assert status == 2, text
    assert "Traceback" not in text
    if text.startswith("kr210-sim:"):
        assert text.count("\n") == 1


# ---- files ----------------------------------------------------------------------------------

OPTIONS = RunConfig(seed=5, cell="3", randomize="nominal", max_ik_offset=1e-6).as_json()
BLOCK = resource("assets", "randomization", "hard.toml").read_text(encoding="utf-8")
SCENE = resource("scenes", "shelf_and_bin.xml").read_text(encoding="utf-8")
ARM = re.sub(  # without its meshes, which lie elsewhere
    r"<mesh\b[^>]*/>",
    '<box size="0.1 0.1 0.2"/>',
    (Path(__file__).parent / "robots" / "offset_arm.urdf").read_text(encoding="utf-8"),
)


@given(content=changed(OPTIONS) | VALUES)
@fuzz(4)
def test_any_json_of_options_is_taken_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "options.json"
    path.write_text(json.dumps(content))
    taken_or_refused(lambda: RunConfig(**read_options(path)))


@given(raw=mutated(BLOCK))
@fuzz(4)
def test_any_block_of_random_quantities_is_taken_or_refused(tmp_path_factory, raw):
    path = tmp_path_factory.getbasetemp() / "block.toml"
    path.write_bytes(raw)
    taken_or_refused(lambda: read_randomization(str(path)))


@given(raw=mutated(SCENE))
@fuzz()
def test_any_scene_is_built_or_refused(tmp_path_factory, robot, spec, raw):
    path = tmp_path_factory.getbasetemp() / "scene.xml"
    path.write_bytes(raw)
    taken_or_refused(lambda: build_scene(path, robot, spec))


@given(raw=mutated(ARM))
@fuzz()
def test_any_description_is_built_or_refused(tmp_path_factory, raw):
    path = tmp_path_factory.getbasetemp() / "arm.urdf"
    path.write_bytes(raw)
    taken_or_refused(lambda: load_robot(RobotSource(path=path)))


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("fuzz") / "run"
    make_run(out, [make_record(0), make_record(1, DROPPED), make_record(2)])
    return out


@pytest.mark.parametrize("use", [load_run, read_run, lambda out: compare_runs(out, out)])
@pytest.mark.parametrize("name", ["config.json", "summary.json", "cycles.jsonl"])
@given(data=st.data())
@fuzz(0.5)
def test_any_folder_of_a_run_is_read_or_refused(run_folder, use, name, data):
    path = run_folder / name
    whole = path.read_text(encoding="utf-8")
    if data.draw(st.booleans()):
        raw = data.draw(mutated(whole))
    else:
        parts = [json.loads(line) for line in whole.splitlines()] if "cycles" in name else None
        content = data.draw(changed(parts or json.loads(whole)))
        lines = content if parts and isinstance(content, list) else [content]
        raw = "".join(json.dumps(line) + "\n" for line in lines).encode()
    try:
        path.write_bytes(raw)
        taken_or_refused(lambda: use(run_folder))
    finally:
        path.write_text(whole, encoding="utf-8")
