"""The tree of errors, exit codes, and the import of libraries that may be missing.

::

    ContactTrackerError
    |-- InputError            the input cannot be used                    (exit code 1)
    |   |-- UnreadableRecording   not a recording, or wholly unreadable
    |   |-- NoPoses               a recording without a known pose source
    |   |-- InvalidPose           poses from Python that did not pass the gate
    |   |-- StateError            a saved state that cannot be resumed
    |   `-- NoTruth               evaluation of a recording without ground truth
    |-- OutputError           from Python: a file cannot be written       (exit code 1)
    |-- ViewerError           the viewer does not start or takes no data  (exit code 1)
    `-- UsageError            the call is wrong                           (exit code 2)
        |-- ChoiceError           a topic, frame, interval or unit does not fit this recording
        |   `-- AmbiguousSource       several pose sources: choose with --topic / --frame
        |-- ArgumentError         from Python: no argument has that name; a TypeError as well
        |-- MissingExtra          a format needs a library that is not installed
        `-- KeyFault              a file with a missing or impossible value
            |-- ModelError            of a model
            `-- KnowledgeError        of a map

It is an InputError if no call could use the input, and a UsageError if another call could, such as one with a
topic or frame that the recording has. docs/conventions.md says the same to users.

A partly readable recording is not an error: the readable part is processed and the damage reported as a
status (exit code 3). A fit that does not converge is a status as well.

From Python, doubtful input that is no error causes a ``ContactTrackerWarning`` of the module ``warnings``.
"""

import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import Final

DONE: Final = 0
INPUT: Final = 1
USAGE: Final = 2
DAMAGED: Final = 3
DIFFERENT: Final = 4
"""Two takes differ, or a stream has left its plan."""
UNEXPECTED: Final = 70
"""Status of a recording in a batch: a fault of this package."""
INTERRUPTED: Final = 130
KILLED: Final = 137
"""Status of a recording in a batch: the processes that segmented it were killed."""


def printable(text: str) -> str:
    """``text`` in one line, with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


_SHORT: Final = reprlib.Repr()
_SHORT.maxstring = 100


def shown(value: object) -> str:
    """A wrong value in a message: as Python writes it, cut short."""
    try:
        return _SHORT.repr(str(value) if isinstance(value, str) else value)
    except ValueError:  # an integer of thousands of digits
        return f"a very long {type(value).__name__}"


def first_line(error: BaseException) -> str:
    """The first line of the text of an error of a library, or the name of its class if it has no text."""
    return (str(error) or type(error).__name__).splitlines()[0]


class ContactTrackerError(Exception):
    """Base of all errors raised on purpose; its text is one line that says what to do."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(text))


class InputError(ContactTrackerError):
    """The input cannot be used."""


class UnreadableRecording(InputError):
    """Not a recording, or nothing in it can be read."""


class NoPoses(InputError):
    """The recording has no pose source of a known type."""


class InvalidPose(InputError):
    """A pose that the gate (``motion.pose_validation``) would reject."""


class StateError(InputError):
    """A saved state that is damaged, of another version, or no state."""


class NoTruth(InputError):
    """The recording has no ground truth."""


class OutputError(ContactTrackerError):
    """A result or a state cannot be written."""


class ViewerError(ContactTrackerError):
    """The viewer does not start, or does not take the data."""


class UsageError(ContactTrackerError):
    """The call is wrong."""


class ChoiceError(UsageError):
    """A topic, frame, interval or unit that the call names is not in this recording, or does not fit it."""


class ArgumentError(UsageError, TypeError):
    """An argument of a call is unknown to the function."""


class AmbiguousSource(ChoiceError):
    """There are several pose sources; one has to be chosen."""


class MissingExtra(UsageError):
    """An input or output needs a library of an extra of this package."""


class KeyFault(UsageError):
    """A ``key`` of a file, or the file (no key), is missing, unknown, of the wrong type or out of range."""

    NAMES = "{key}", "the file"
    """Beginning of the text with a key, and without one."""

    def __init__(self, key: str, reason: str) -> None:
        super().__init__(f"{self.NAMES[0].format(key=key) if key else self.NAMES[1]}: {reason}")
        self.key = key
        self.reason = reason

    def __reduce__(self) -> tuple[type[ContactTrackerError], tuple[str, str]]:
        return type(self), (self.key, self.reason)  # for pickle, from worker processes


class ModelError(KeyFault):
    """A model, or a parameter of it, that is impossible."""

    NAMES = "model parameter {key}", "model"


class KnowledgeError(KeyFault):
    """A map that is impossible or cannot be read."""

    NAMES = "known {key}", "what is known"


class ContactTrackerWarning(UserWarning):
    """A fault of the input, from Python; the command line warns in the same words, but names options instead
    of arguments."""


class SlowUpdate(ContactTrackerWarning):
    """Numpy replaces the compiled kernels. The command line reports it in one line."""


@contextmanager
def extra(name: str, purpose: str) -> Iterator[None]:
    """A context for imports of libraries of the extra ``name``, needed for ``purpose``.

    Raises
    ------
    MissingExtra
        A library is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        library = (error.name or "a library").partition(".")[0]
        raise MissingExtra(f"{purpose} needs {library}: pip install 'contact-tracker[{name}]'") from None


def module_of_extra(module: str, name: str, purpose: str) -> ModuleType:
    """The ``module`` of a library of the extra ``name``; raises as ``extra`` does."""
    with extra(name, purpose):
        return import_module(module)
