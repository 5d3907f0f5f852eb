"""The JSON Schema of a report, generated from the types that validate a report when it is read."""

from __future__ import annotations

from typing import Any

import msgspec

from ..formats.schemas.report import Report
from .stored import FORMAT

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def report_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of what `fix` writes and ``estimate --json`` prints."""
    return {"$schema": DRAFT, "title": FORMAT, **_alike(msgspec.json.schema(Report))}


def _alike(part: Any) -> Any:
    """The `part` of a schema in the same form by all versions of msgspec: each description on one line, alternatives in
    alphabetical order."""
    if isinstance(part, list):
        return [_alike(each) for each in part]
    if not isinstance(part, dict):
        return part
    part = {key: _alike(value) for key, value in part.items()}
    if isinstance(part.get("description"), str):
        part["description"] = " ".join(part["description"].split())
    if "anyOf" in part:
        part["anyOf"] = sorted(part["anyOf"], key=str)
    return part
