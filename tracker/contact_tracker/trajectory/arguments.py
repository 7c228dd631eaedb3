"""Conversion and checks of arguments from Python, and warnings of the module ``warnings``."""

import inspect
import logging
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from functools import wraps
from types import FrameType
from typing import Any, Final, ParamSpec, TypeVar

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.config.quantities import deviations, plausible
from contact_tracker.config.table_reading import TableReading
from contact_tracker.errors import (
    ArgumentError,
    ContactTrackerError,
    ContactTrackerWarning,
    UsageError,
    printable,
    shown,
)
from contact_tracker.motion.losses import counts_text
from contact_tracker.motion.poses import NO_OUTLIERS, Outliers, real_number
from contact_tracker.suggestions import closest, near_file

ModelLike = str | os.PathLike[str] | Model
P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")
Deviations = str | tuple[float, float] | None
_PACKAGE: Final = __name__.partition(".")[0]
_LOGGER: Final = logging.getLogger(_PACKAGE)


def path_from(value: Any, name: str = "path") -> str:
    """A path as text; raises UsageError if ``value`` is not a path. ``name`` is that of the argument."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if isinstance(text, str) and "\0" not in text:
        return text
    raise UsageError(f"{name} is the name of a file, not {shown(value)}")


def name_from(value: Any, name: str) -> str | None:
    """The text or None that was passed as the argument ``name``; raises UsageError for other types."""
    if value is None or isinstance(value, str):
        return value
    raise UsageError(f"{name} is text, not {shown(value)}")


def number_from(value: Any, name: str, bounds: str, is_within: Callable[[float], bool]) -> float:
    """A finite number that ``is_within`` its ``bounds`` (their text); raises UsageError about ``name``."""
    try:
        number = real_number(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if math.isfinite(number) and is_within(number):
        return number
    raise UsageError(f"{name} is a number {bounds}, not {shown(value)}")


@contextmanager
def errors_as(kind: type[ContactTrackerError], path: str) -> Iterator[None]:
    """A context that turns errors of the system on the file at ``path`` into errors of this ``kind``."""
    try:
        yield
    except OSError as error:
        name = error.filename or path
        raise kind(f"{name}: {error.strerror or error}{near_file(name)}") from error


_OF_READING: Final = frozenset(
    ("topic", "parent", "child", "relative_to", "rate", *(f.name for f in fields(TableReading) if f.compare))
)
"""Arguments that say how poses are read."""
_IN_PYTHON: Final = {"frame": "child", "map": "meanings"}
"""Arguments of Python by the name of their option on the command line, where they differ."""
_OPTIONS: Final = (
    *sorted(name.replace("_", "-") for name in _OF_READING | {*_IN_PYTHON}),
    *("accuracy", "box", "known", "model", "noise", "plane", "states", "up", "wrench"),
)
"""Options of the command line that are arguments in Python, too."""
_OPTION: Final = re.compile(
    rf"(?<![^\s(])--({'|'.join(_OPTIONS)})(?![\w-])"
    r"(?: (?!(?:or|and|for|beside|does|do|is|are|if|by|to) )('[^']*'|[^\s;()]*[^\s,;().]))?"
)
"""One of these, and its value."""


def python_words(text: str) -> str:
    """A message with the arguments of Python in the place of the options of the command line."""

    def argument(option: re.Match[str]) -> str:
        name, value = option[1].replace("-", "_"), option[2]
        name = _IN_PYTHON.get(name, name)
        if value is None:
            return name
        value = value.strip("'")
        if name == "columns":
            return f"columns={dict(part.partition('=')[::2] for part in value.split(','))!r}"
        parent, arrow, child = value.partition("->")
        return f"parent={parent!r}, child={child!r}" if arrow else f"{name}={value!r}"

    return _OPTION.sub(argument, text)


@contextmanager
def in_python() -> Iterator[None]:
    """A context whose errors name arguments of Python instead of options of the command line."""
    try:
        yield
    except ContactTrackerError as error:
        error.args = (python_words(str(error)),)
        raise


def with_known_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """The function with an error for unknown arguments that says what to do instead.

    Raises
    ------
    ArgumentError
        From the function: an argument of the call is unknown.
    """
    names = [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]
    title = function.__qualname__.removesuffix(".__init__")

    @wraps(function)
    def call(*args: P.args, **named: P.kwargs) -> R:
        for name in named:
            if name in names or name in ("self", "cls"):
                continue
            if name in _OF_READING and "trajectory" in names:
                option = f"{name}={named[name]!r}"
                raise ArgumentError(
                    f"{title} has no argument {name}, which says how poses are read: "
                    f"{title}(contact_tracker.read(path, {option})), or, of a table in memory, "
                    f"{title}(contact_tracker.Trajectory.from_dataframe(table, {option}))"
                )
            near = _IN_PYTHON.get(name) or closest(name, names)
            hint = f"did you mean {near}?" if near in names else f"there are {', '.join(names) or 'none'}"
            raise ArgumentError(f"{title} has no argument {name}; {hint}")
        return function(*args, **named)

    return call


def with_known_arguments_of_methods(cls: type[T]) -> type[T]:
    """The class, whose own public methods raise as those ``with_known_arguments``."""
    for name, member in [*vars(cls).items()]:
        if isinstance(member, classmethod):
            setattr(cls, name, classmethod(with_known_arguments(member.__func__)))
        elif inspect.isfunction(member) and (name == "__init__" or not name.startswith("_")):
            setattr(cls, name, with_known_arguments(member))
    return cls


def model_from(model: ModelLike, noise: Deviations = None, accuracy: Deviations = None) -> Model:
    """A model, given by its name, file or value, with the given noise and systematic errors of a pose.

    Raises
    ------
    ModelError
        The model does not exist, or has a wrong value.
    UsageError
        The noise or the accuracy is invalid.
    """
    loaded = model if isinstance(model, Model) else load_model(path_from(model, "model"))
    if noise is not None:
        loaded = loaded.with_noise(*_deviations_from(noise, "noise"))
    if accuracy is not None:
        loaded = loaded.with_systematic_errors(*_deviations_from(accuracy, "accuracy", may_be_zero=True))
    return loaded


def _deviations_from(
    value: str | tuple[float, float], name: str, may_be_zero: bool = False
) -> tuple[float, float]:
    """Standard deviations of position (m) and rotation (rad); raises UsageError about ``name``."""
    try:
        if isinstance(value, str):
            return deviations(value, may_be_zero)
        position_m, rotation_rad = map(real_number, value)
        return plausible((position_m, rotation_rad), value, may_be_zero)
    except (TypeError, ValueError, OverflowError, LookupError) as error:
        raise UsageError(f"{name} is '0.3mm,0.15deg' or (metres, radians): {error}") from error


def warn_of(texts: Iterable[str]) -> None:
    """Issue a warning for each text, at the user's line.

    Python's registry of warnings is not used: the same text at the same line may concern another recording.
    """
    for text in texts:
        caller = _caller()
        module = str(caller.f_globals.get("__name__", "<unknown>"))
        place = caller.f_code.co_filename, caller.f_lineno
        warnings.warn_explicit(printable(python_words(text)), ContactTrackerWarning, *place, module)


def log_counts(
    name: str, counts: Mapping[str, int], outliers: Outliers = NO_OUTLIERS, origin_ns: int = 0
) -> None:
    """Log the numbers of dropped and repaired poses at the level INFO."""
    if noted := counts_text(counts, outliers, origin_ns):
        _LOGGER.info("%s: noted: %s", printable(name), noted)


def log_text(text: str) -> None:
    """Log a message at the level INFO."""
    _LOGGER.info("%s", printable(text))


def _caller() -> FrameType:
    """The innermost frame outside of the package; the outermost frame if there is none."""
    frame = sys._getframe()
    while frame.f_back and str(frame.f_globals.get("__name__", "")).partition(".")[0] == _PACKAGE:
        frame = frame.f_back
    return frame
