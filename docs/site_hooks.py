"""For mkdocs: what pages link to outside docs/ becomes part of the site."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(\]\()((?:\.\./)+[^)#\s]+)")
LANGUAGES = {".py": "python", ".xacro": "xml", ".xml": "xml", ".toml": "toml"}


def _outside(page: str, target: str) -> str | None:
    """Return the path in the repository of a link that leaves docs/, else None."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return None if path.startswith("docs/") or not (ROOT / path).is_file() else path


def _name(path: str) -> str:
    """Return the page of the site that shows a file of the repository."""
    return f"source/{path}" if path.endswith(".md") else f"source/{path}.md"


def on_files(files: Any, config: Any) -> Any:
    """Add a page for every file outside docs/ that a page links to."""
    waiting = [(file.src_uri, file.content_string) for file in files.documentation_pages()]
    known: set[str] = set()
    for page, text in waiting:
        for _, target in LINK.findall(text):
            path = _outside(page, target)
            if path is None or path in known:
                continue
            known.add(path)
            content = (ROOT / path).read_text(encoding="utf-8")
            if not path.endswith(".md"):
                language = LANGUAGES.get(Path(path).suffix, "")
                content = f"# {path}\n\n````{language}\n{content}````\n"
            else:  # its own links are the repository's, which the site does not have
                content = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", content)
                content = re.sub(r"\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", content)
            files.append(File.generated(config, _name(path), content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Let links that leave docs/ lead to these pages."""
    here = page.file.src_uri

    def led(match: re.Match[str]) -> str:
        path = _outside(here, match[2])
        if path is None:
            return match[0]
        return match[1] + posixpath.relpath(_name(path), posixpath.dirname(here) or ".")

    return LINK.sub(led, markdown)
