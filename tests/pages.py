"""Pages as trees, and what every page must be: valid, alone, and readable by everybody."""

from __future__ import annotations

import re
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import html5lib

HTML = "{http://www.w3.org/1999/xhtml}"
SVG = "{http://www.w3.org/2000/svg}"
HEADINGS = tuple(f"{HTML}h{level}" for level in range(1, 7))


def parsed(path: Path) -> Any:
    """The page as a tree; any error of its HTML is one of the test."""
    return html5lib.HTMLParser(strict=True).parse(path.read_text(encoding="utf-8"))


def text_of(element: Any) -> str:
    return " ".join(" ".join(element.itertext()).split())


def section(tree: Any, name: str) -> Any:
    return next(e for e in tree.iter(f"{HTML}section") if e.get("id") == name)


def assert_alone(path: Path, *, links: frozenset[str] = frozenset()) -> None:
    """The page loads nothing and leads nowhere but to these links."""
    for element in parsed(path).iter():
        assert element.tag not in {f"{HTML}{tag}" for tag in ("script", "link", "img", "iframe")}
        for name in ("src", "href", "{http://www.w3.org/1999/xlink}href"):
            target = element.get(name, "#")
            assert target.startswith("#") or target in links, element.attrib
    assert "url(http" not in path.read_text()
    assert "@import" not in path.read_text()


def linked_ids(tree: Any) -> set[str]:
    """Every id is there once, and every link within the page leads to one; return the ids."""
    ids = Counter(element.get("id") for element in tree.iter() if element.get("id"))
    assert max(ids.values()) == 1
    links = {element.get("href") for element in tree.iter() if element.get("href")}
    assert {link[1:] for link in links if link.startswith("#")} <= set(ids)
    named = {part for e in tree.iter() for part in re.findall(r"url\(#([^)]+)\)", str(e.attrib))}
    assert named <= set(ids)
    return set(ids)


def assert_readable(tree: Any, *, drawings: int) -> None:
    """Headings in order, every drawing described, every table reached by keyboard."""
    assert tree.get("lang") == "en"
    assert len(list(tree.iter(f"{HTML}main"))) == len(list(tree.iter(f"{HTML}h1"))) == 1
    levels = [int(e.tag[-1]) for e in tree.iter() if e.tag in HEADINGS]
    assert all(after <= before + 1 for before, after in pairwise(levels))
    drawn = list(tree.iter(f"{SVG}svg"))
    assert len(drawn) >= drawings
    assert all(d.get("role") == "img" and len(d.get("aria-label")) > 20 for d in drawn)
    boxes = [e for e in tree.iter(f"{HTML}div") if e.get("class") == "scroll"]
    assert boxes
    assert all(box.get("tabindex") == "0" and box.get("aria-label") for box in boxes)
    assert all(cell.get("scope") in ("col", "row") for cell in tree.iter(f"{HTML}th"))
