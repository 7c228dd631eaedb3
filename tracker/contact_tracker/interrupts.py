"""Signals that end a command: they become exceptions, so that resources are released before the exit."""

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")
"""Names of the signals with which users and systems end a command."""
_SIGNALLED: Final = 128
"""Exit code of a process that a signal ends, less the number of the signal."""
_AGAIN_S: Final = 0.02
"""Time in seconds after which a signal is repeated."""
_IMPORTS: Final = "<frozen importlib."
"""Beginning of the file names of Python's import system."""
_raised = 0
"""Number of the signal that raised the last exception, and that ends the process."""
_is_due = False
"""Whether an interrupt waits to be repeated."""


def end_in_order(*names: str) -> None:
    """Make SIGINT a ``KeyboardInterrupt`` and other signals a ``SystemExit``, unless they are ignored.

    If Python cannot raise the exception, as in a destructor, the signal is repeated. An interrupt also waits
    for the end of imports: extension modules that it interrupts raise other errors, or stay incomplete.
    """
    for number in _numbers(names):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as in background jobs, and by nohup
            signal.signal(number, _end)
    global _raised
    if sys.unraisablehook is sys.__unraisablehook__:
        sys.unraisablehook, _raised = _repeat_or_report, 0


def exit_code_of(name: str) -> int | None:
    """Exit code of a command that the signal ``name`` ends; None if this system has no such signal."""
    number = getattr(signal, name, None)
    return None if number is None else _SIGNALLED + number


def is_due() -> bool:
    """Whether an interrupt is pending because Python could not raise it."""
    return _is_due


@contextmanager
def deferred(*names: str) -> Iterator[None]:
    """A context that defers these signals, if they exist and are not ignored, to its end."""
    arrived: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():  # handlers can be set only there
        for number in _numbers(names):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                handlers[number] = signal.signal(number, lambda number, _: arrived.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if arrived:
            signal.raise_signal(arrived[0])


def repeat_unless(number: int, ended: Callable[[], bool], after_s: float) -> None:
    """Send a signal to this process again after ``after_s`` seconds, unless ``ended()``."""
    main = _thread.get_ident()  # signals are handled only there

    def watch() -> None:
        time.sleep(after_s)
        if ended():
            return
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main, number)  # wakes it up if it is waiting
        else:
            _thread.interrupt_main(signal.Signals(number))

    _thread.start_new_thread(watch, ())  # it needs no lock, which the interrupted code may have


def _numbers(names: tuple[str, ...]) -> list[int]:
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


def _end(number: int, frame: FrameType | None) -> None:
    global _is_due, _raised
    while frame is not None and number == signal.SIGINT:
        if frame.f_code.co_filename.startswith(_IMPORTS):
            _repeat(number)
            return
        frame = frame.f_back
    if number == _raised != signal.SIGINT:  # it ends already, and must not stop what cleans up
        return
    _is_due, _raised = False, number
    raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(_SIGNALLED + number)


def _repeat(number: int) -> None:
    global _is_due
    _is_due = _is_due or number == signal.SIGINT
    repeat_unless(number, lambda: False, _AGAIN_S)


def _repeat_or_report(raised: "UnraisableHookArgs", /) -> None:
    """Hook for exceptions that Python cannot raise: repeats the signal that raised one, and reports others,
    except after an interrupt, which leaves objects incomplete."""
    global _raised
    if _raised and issubclass(raised.exc_type, KeyboardInterrupt | SystemExit):
        _repeat(_raised)
        if _raised != signal.SIGINT:
            _raised = 0  # the repeated signal ends the process
    elif _raised != signal.SIGINT:
        sys.__unraisablehook__(raised)
