"""What pages show: their fenced blocks, and the commands in them and in their lines."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted({
    *ROOT.glob("*.md"), *ROOT.glob("ik/*.md"), *ROOT.glob("docs/**/*.md"),
    *ROOT.glob("assets/**/*.md"), *ROOT.glob("examples/**/*.md"), *ROOT.glob("scenes/**/*.md"),
})  # fmt: skip
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`((?:kr210-sim|python|pip|mkdocs|ruff|mypy|\.ci/run)\b[^`]*)`")
COMMANDS = ("", "sh")
"""Languages of blocks in which every line is a command: output is marked `text`."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """Return language and text of every fenced block of a page."""
    return FENCE.findall(page.read_text(encoding="utf-8"))


def commands(pages: Iterable[Path]) -> list[str]:
    """Return every fenced command of the pages, once, without its comment."""
    lines = (
        shlex.join(shlex.split(part, comments=True))
        for page in pages
        for language, text in blocks(page)
        if language in COMMANDS
        for line in text.replace("\\\n", " ").splitlines()
        for part in line.split(" && ")
    )
    return list(dict.fromkeys(line for line in lines if line))


def my_scene(path: Path) -> None:
    """Write the scene of docs/scenes.md, and beside it the one that it includes."""
    (text,) = (text for language, text in blocks(ROOT / "docs" / "scenes.md") if language == "xml")
    path.write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "scenes" / "shelf_and_bin.xml", path.parent)


def assert_prints_what_stands_below(page: Path) -> None:
    """Run each Python block of a page as it stands, and compare what it prints."""
    found = blocks(page)
    for (language, text), (after, shown) in zip(found, [*found[1:], ("", "")], strict=True):
        if language != "python":
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(text, str(page), "exec"), {})  # without those above
        assert after == "text", f"no output stands below a snippet of {page.name}"
        assert printed.getvalue() == shown


def mentions(page: Path) -> list[str]:
    """Return the commands that stand between backticks within the lines of a page."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    return [part for span in SPAN.findall(text) for part in " ".join(span.split()).split(" && ")]
