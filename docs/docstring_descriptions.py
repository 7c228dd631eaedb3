"""Reads the docstrings of this package for the API pages: after ``name :`` comes a description, not a type.

Types are in the signatures. The numpy style that mkdocstrings reads has a type in this place and the
description on the lines below, so the description is moved there.
"""

import re
from typing import Any, Final

import griffe

SECTION: Final = re.compile(r"(^Parameters\n-{4,}\n)(.*?)(?=\n\n\S+\n-{4,}\n|\Z)", re.MULTILINE | re.DOTALL)
ENTRY: Final = re.compile(r"^(\w[\w, *]*?) : (?=\S)", re.MULTILINE)


def with_descriptions_below(docstring: str) -> str:
    """The same docstring as the numpy style wants it."""
    return SECTION.sub(lambda found: found[1] + ENTRY.sub(r"\1\n    ", found[2]), docstring)


class DescriptionsBelow(griffe.Extension):
    """Applies ``with_descriptions_below`` to whatever is loaded."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = with_descriptions_below(obj.docstring.value)
