"""Write docs/licences.md: the licence of everything that pyproject.toml names, by its own metadata.

`python docs/make_licences.py` in an environment with all extras; what is not installed keeps its
line. tests/test_papers.py fails where the page lacks a package or has one too many.
"""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "licences.md"
HEAD = """# Licences

Ours is MIT. Below is what the packages that `pyproject.toml` names say of themselves; what these
bring in turn is not listed. *core* comes with the plain installation, the rest with the extras
named. Written by `python docs/make_licences.py`.

The wheel of imageio-ffmpeg carries an ffmpeg executable under the GPL (version 3, with x264). We
start it as a program and pass it on to nobody; who ships it along with us ships it under its terms.

| package | for | licence | version looked at |
|---|---|---|---|
"""
_SHORT = 40  # a longer licence field is a text
_TEXTS = {"Redistribution and use in source and binary forms": "BSD"}


def needed() -> dict[str, list[str]]:
    """Return package -> what needs it: "core", or the names of extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found: dict[str, list[str]] = {}
    for extra, lines in {
        "core": project["dependencies"],
        **project["optional-dependencies"],
    }.items():
        for line in lines:
            name = re.match(r"[\w.-]+", line)
            if name and name[0] != project["name"]:
                found.setdefault(name[0], []).append(extra)
    return dict(sorted(found.items(), key=lambda item: item[0].lower()))


def licence(found: Distribution) -> str:
    """Return the licence that a package states: expression, classifier, field, or file."""
    of = found.metadata
    if of.get("License-Expression"):
        return str(of["License-Expression"])
    classifiers = [each for each in of.get_all("Classifier") or () if each.startswith("License")]
    if classifiers:
        return ", ".join(each.rpartition(" :: ")[2] for each in classifiers)
    text = str(of.get("License") or "")
    if text and len(text) <= _SHORT:
        return text
    for path in () if text else found.files or ():
        if re.search(r"licen[cs]e|copying", path.name, re.IGNORECASE):
            text = str(path.locate().read_text(encoding="utf-8"))
    first = next(iter(text.strip().splitlines()), "")
    known = (name for start, name in _TEXTS.items() if start in " ".join(text.split()))
    return next(known, first if len(first) <= _SHORT else "") or "not stated; see its files"


def rows(page: str) -> dict[str, str]:
    """Return package -> line of a page."""
    lines = page.splitlines()[HEAD.count("\n") :]
    return {line.split(" | ")[0].removeprefix("| "): line for line in lines}


def written(page: str) -> str:
    """Return the page as the installed metadata make it."""
    before, lines = rows(page), []
    for name, extras in needed().items():
        try:
            found = distribution(name)
        except PackageNotFoundError:
            if name in before:
                lines.append(before[name])
            continue
        lines.append(f"| {name} | {', '.join(extras)} | {licence(found)} | {found.version} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""), "utf-8")
