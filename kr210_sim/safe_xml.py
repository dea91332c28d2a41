"""XML from outside, before any parser builds a tree of it: size, depth and entities are bounded."""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from kr210_sim.exceptions import BadInput

MAX_XML_BYTES = 10_000_000
"""Largest description or include that is read."""

MAX_DEPTH = 200
"""Deepest nesting of elements."""


def read_xml(path: Path) -> bytes:
    """Return the content of an XML file that is safe to parse; it may still be malformed.

    Raises:
        BadInput: if it cannot be read, is too large, too deep, or declares entities.
    """
    try:
        size = path.stat().st_size
        if size > MAX_XML_BYTES:
            raise BadInput(
                f"{path}: has {size / 1e6:.0f} MB; a description has less than "
                f"{MAX_XML_BYTES / 1e6:.0f} MB"
            )
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); check the file") from error
    check_xml(content, str(path))
    return content


def check_xml(content: bytes, where: str) -> None:
    """Refuse XML that would cost more to parse than its size promises.

    Raises:
        BadInput: if it declares entities or nests too deep, naming the place.
    """
    parser = expat.ParserCreate()
    depth = 0

    def start(_name: str, _attributes: object) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise BadInput(f"{where}: elements nest deeper than {MAX_DEPTH}; flatten the file")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    def entity(name: str, *_: object) -> None:
        raise BadInput(f"{where}: declares the XML entity '{name}'; write its text instead")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError):
        return  # malformed or of an unknown encoding: the parser that needs it says where
