"""Safe handling of interrupts (Ctrl-C): they wait for imports, and child processes leave them to their
parent, with which they end."""

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals by which users and systems end a command."""
_SIGNALLED: Final = 128
"""Added to the number of a signal, it is the exit code of a process that is ended by it."""
_AGAIN_S: Final = 0.02
_IMPORTS: Final = "<frozen importlib."
_is_due = False


def wait_for_imports() -> None:
    """Make an interrupt a ``KeyboardInterrupt`` that waits until no module is being imported.

    Extension modules that are interrupted in their import raise other errors, or leave an incomplete module.
    Where Python cannot raise it, as in a destructor, it is repeated.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # background jobs ignore it
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _unraisable


def end_in_order(*names: str) -> None:
    """Make the signals with these names, if they exist and are not ignored, a ``SystemExit``, so that
    resources are released before the exit.

    Where Python cannot raise it, as in a destructor, the signal is repeated.
    """
    for number in (getattr(signal, name) for name in names if hasattr(signal, name)):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup does
            signal.signal(number, _end)
    if sys.unraisablehook is sys.__unraisablehook__:
        sys.unraisablehook = _unraisable


def exit_code_of(name: str) -> int | None:
    """Exit code of a command that a signal with this name ends; None where there is no such signal."""
    number = getattr(signal, name, None)
    return None if number is None else _SIGNALLED + number


def is_due() -> bool:
    """Whether an interrupt is pending because Python could not raise it."""
    return _is_due


def ignore() -> None:
    """Ignore interrupts during the exit."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Processes started in this context are never interrupted; an interrupt of this one waits for its end.

    A terminal interrupts all processes of a command, but only one of them has to end the others.
    """
    with deferred("SIGINT"), _blocked():
        yield


@contextmanager
def deferred(*names: str) -> Iterator[None]:
    """Defer the signals with these names, if they exist and are not ignored, to the end of the context."""
    arrived: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():  # handlers can be set only there
        for number in (getattr(signal, name) for name in names if hasattr(signal, name)):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                handlers[number] = signal.signal(number, lambda number, _: arrived.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if arrived:
            signal.raise_signal(arrived[0])


@contextmanager
def _blocked() -> Iterator[None]:
    """Block interrupts in this thread, which children inherit; another thread may still receive them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # starting it later would unblock interrupts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """In a process of ``multiprocessing``: end with the parent, even if that is killed.

    Otherwise it would wait for work forever.
    """
    from multiprocessing import parent_process
    from os import _exit

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            _exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _interrupt(_: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTS):
            _interrupt_again()
            return
        frame = frame.f_back
    global _is_due
    sys.unraisablehook = _unraisable_after
    _is_due = False
    raise KeyboardInterrupt


def _end(number: int, _: FrameType | None) -> None:
    sys.exit(_SIGNALLED + number)


def _interrupt_again() -> None:
    global _is_due
    _is_due = True
    _repeat(signal.SIGINT)


def repeat_unless(number: int, ended: Callable[[], bool], after_s: float) -> None:
    """Send a signal to this process again after some time, unless ``ended``."""

    def watch() -> None:
        time.sleep(after_s)
        if not ended():
            os.kill(os.getpid(), number)

    threading.Thread(target=watch, daemon=True).start()


def _repeat(number: int) -> None:
    """Send a signal to this process again, soon."""
    main = _thread.get_ident()  # signals are handled only there

    def after_a_while() -> None:
        time.sleep(_AGAIN_S)
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main, number)  # wakes it up if it is waiting
        else:
            _thread.interrupt_main(signal.Signals(number))

    _thread.start_new_thread(after_a_while, ())


def _unraisable(raised: "UnraisableHookArgs", /) -> Any:
    if not _repeated(raised):
        sys.__unraisablehook__(raised)


def _unraisable_after(raised: "UnraisableHookArgs", /) -> Any:
    """Suppress errors of destructors of objects that an interrupt left incomplete."""
    _repeated(raised)


def _repeated(raised: "UnraisableHookArgs") -> bool:
    """Repeat the signal by which an exception was raised, if it was by one."""
    if issubclass(raised.exc_type, KeyboardInterrupt):
        _interrupt_again()
        return True
    code = raised.exc_value.code if isinstance(raised.exc_value, SystemExit) else None
    number = code - _SIGNALLED if isinstance(code, int) else 0
    is_ours = number > 0 and signal.getsignal(number) is _end
    if is_ours:
        _repeat(number)
    return is_ours
