"""Docstrings for the site: a line that explains a name (``path : of the input``) becomes an item of a list."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

EXPLAINED = re.compile(r"(?:^|(?<=[.;] ))(\w+(?:, \w+)*|``[^`]+``) : ", re.MULTILINE)


class DocstringLists(Extension):
    """Called by mkdocstrings for everything that it reads."""

    def on_object(self, *, obj: Object, **kwargs: Any) -> None:
        """Change the docstring of `obj` in place, once."""
        if obj.docstring is not None:
            obj.docstring.value = EXPLAINED.sub(r"\n- **\1**: ", obj.docstring.value)
