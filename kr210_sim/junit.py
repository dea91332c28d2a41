"""The cycles of a run as JUnit test cases, one a cycle, for CI servers to show."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

_FORBIDDEN = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot hold."""


def write_junit(
    path: Path,
    lines: Iterable[Mapping[str, Any]],
    summary: Mapping[str, Any],
    *,
    name: str,
    command: Callable[[int], str],
) -> None:
    """Write a test suite with a case per cycle; a failed cycle has its reason, stage and time.

    Args:
        path: of the XML file.
        lines: cycles as `cycles.jsonl` has them, read once and not kept.
        summary: of the same cycles.
        name: of the suite.
        command: what shows a cycle again, by its index.
    """
    with path.open("w", encoding="utf-8") as file:
        xml = XMLGenerator(file, "utf-8", short_empty_elements=True)
        xml.startDocument()
        counts = {
            "name": _clean(name),
            "tests": str(summary["cycles"]),
            "failures": str(summary["cycles"] - summary["succeeded"]),
            "errors": "0",
            "time": f"{summary['wall_time_s']:.3f}",
        }
        xml.startElement("testsuites", AttributesImpl({}))
        xml.startElement("testsuite", AttributesImpl(counts))
        for line in lines:
            xml.characters("\n")
            _case(xml, line, command)
        xml.characters("\n")
        xml.endElement("testsuite")
        xml.endElement("testsuites")
        xml.endDocument()
        file.write("\n")


def _case(xml: XMLGenerator, line: Mapping[str, Any], command: Callable[[int], str]) -> None:
    seconds = line["wall_clock"].get("wall_time_s") or 0.0
    attributes = {
        "classname": f"episode_{line['episode']:04d}",
        "name": f"cycle_{line['cycle']:04d}",
        "time": f"{seconds:.3f}",
    }
    xml.startElement("testcase", AttributesImpl(attributes))
    if not line["success"]:
        where = f"{line['failed_stage']} at {line['failed_time_s']:.3f} s"
        cause = {"type": line["reason"], "message": _clean(line["detail"])}
        xml.startElement("failure", AttributesImpl(cause))
        xml.characters(
            _clean(
                f"{line['reason']}: {where}: {line['detail']} "
                f"(seed {line['seed']}, cell {line['cell']})\n"
                f"show it again: {command(line['cycle'])}"
            )
        )
        xml.endElement("failure")
    xml.endElement("testcase")


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("?", text)
