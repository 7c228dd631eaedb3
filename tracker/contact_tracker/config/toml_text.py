"""TOML with bounded work: the standard library's parser takes quadratic time for keys of many parts."""

import re
import tomllib
from typing import Any, Final

MOST_PARTS: Final = 64
_KEY_PART: Final = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_BLANK: Final = r"[ \t]*+"  # possessive: no backtracking, so that the search takes linear time
_LONG_KEY: Final = re.compile(
    rf"(?:^|[{{,]){_BLANK}\[{{0,2}}+{_BLANK}{_KEY_PART}(?:{_BLANK}\.{_BLANK}{_KEY_PART}){{{MOST_PARTS},}}",
    re.MULTILINE,
)


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a text in TOML.

    Raises
    ------
    ValueError, RecursionError
        It is not TOML, or nested too deeply.
    """
    if text.count(".") > MOST_PARTS and _LONG_KEY.search(text):
        raise ValueError(f"a key has more than {MOST_PARTS} parts")
    return tomllib.loads(text)
