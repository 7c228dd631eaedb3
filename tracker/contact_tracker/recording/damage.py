"""Report of a recording's damage in one line of bounded length."""

from typing import Final

_SHOWN: Final = 3


class DamageReport:
    """The first damages as text, further ones counted."""

    def __init__(self) -> None:
        self._shown: list[str] = []
        self._more = 0

    def add(self, text: str) -> None:
        if len(self._shown) < _SHOWN:
            self._shown.append(text)
        else:
            self._more += 1

    def add_all(self, other: "DamageReport", prefix: str = "") -> None:
        """Add another report, with ``prefix`` before each text."""
        for text in other._shown:
            self.add(prefix + text)
        self._more += other._more

    @property
    def text(self) -> str | None:
        """The line, or None without damage."""
        return "; ".join(self._shown) + (f"; and {self._more} more" if self._more else "") or None
