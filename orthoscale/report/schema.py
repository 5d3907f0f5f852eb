"""The JSON Schema of a report, generated from the types that validate a report when it is read."""

from __future__ import annotations

from typing import Any

import msgspec

from ..formats.schemas.report import Report
from .stored import FORMAT

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def report_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of what `fix` writes and ``estimate --json`` prints."""
    return {"$schema": DRAFT, "title": FORMAT, **msgspec.json.schema(Report)}
