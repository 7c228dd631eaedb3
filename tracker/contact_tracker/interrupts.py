"""Signals that end a command: each becomes an exception, so that resources are released before the exit."""

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
"""Signals by which users and systems end a command."""
_SIGNALLED: Final = 128
"""Added to the number of a signal, it is the exit code of a process that is ended by it."""
_AGAIN_S: Final = 0.02
_is_interrupted = False


def end_in_order(*names: str) -> None:
    """Make SIGINT a ``KeyboardInterrupt`` and other signals a ``SystemExit``, unless they are ignored."""
    for number in _numbers(names):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as in background jobs, and by nohup
            signal.signal(number, _end)


def exit_code_of(name: str) -> int | None:
    """Exit code of a command that a signal with this name ends; None where there is no such signal."""
    number = getattr(signal, name, None)
    return None if number is None else _SIGNALLED + number


def is_interrupted() -> bool:
    """Whether an interrupt has come: extension modules that are imported then raise other errors for it."""
    return _is_interrupted


@contextmanager
def deferred(*names: str) -> Iterator[None]:
    """Defer the signals with these names, if they exist and are not ignored, to the end of the context."""
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
    """Send a signal to this process again after some time, unless ``ended``."""
    main = _thread.get_ident()  # signals are handled only there

    def watch() -> None:
        time.sleep(after_s)
        if ended():
            return
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main, number)  # wakes it up if it is waiting
        else:
            _thread.interrupt_main(signal.Signals(number))

    _thread.start_new_thread(watch, ())  # no lock that the interrupted code may hold


def _numbers(names: tuple[str, ...]) -> list[int]:
    return [getattr(signal, name) for name in names if hasattr(signal, name)]


def _end(number: int, _: FrameType | None) -> None:
    global _is_interrupted
    _is_interrupted = number == signal.SIGINT

    def repeat(raised: "UnraisableHookArgs", /) -> None:  # others are of objects left incomplete
        if issubclass(raised.exc_type, KeyboardInterrupt | SystemExit):
            repeat_unless(number, lambda: False, _AGAIN_S)

    sys.unraisablehook = repeat  # as in a destructor, where Python cannot raise it
    raise KeyboardInterrupt if _is_interrupted else SystemExit(_SIGNALLED + number)
