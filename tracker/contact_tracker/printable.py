"""Texts that come from a recording or a file, made fit for a terminal."""


def printable(text: str) -> str:
    """``text`` in one line; whatever could steer a terminal is written as an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
