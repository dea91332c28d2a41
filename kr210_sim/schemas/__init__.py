"""The form of `summary.json` and of a line of `cycles.jsonl`, as JSON Schema 2020-12."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from kr210_sim.exceptions import BadInput

SCHEMA_VERSION = 1
"""Of what a run leaves behind; it grows when a reader of the last one could be misled."""

SCHEMAS = ("summary", "cycle")


def load_schema(name: str) -> dict[str, Any]:
    """Return the schema of a "summary" or of a "cycle", which is a line of `cycles.jsonl`.

    Raises:
        BadInput: if there is no such schema.
    """
    if name not in SCHEMAS:
        raise BadInput(f"schema: no '{name}'; give one of {', '.join(SCHEMAS)}")
    path = Path(__file__).with_name(f"{name}.schema.json")
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
