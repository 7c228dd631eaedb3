"""Interrupts (Ctrl-C) where they would do harm: they wait for imports; children leave them to parents, and
end with these."""

import _thread
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")
"""What people and systems end a command with."""
_AGAIN_S: Final = 0.02
_IMPORTS: Final = "<frozen importlib."
_is_due = False


def wait_for_imports() -> None:
    """From now on an interrupt is a ``KeyboardInterrupt`` that waits until no module is being imported.

    Extension modules that meet one half way make errors of their own of it, or leave a module that lacks a
    part. Where Python cannot raise one, as in a destructor, it comes again.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # jobs in the background ignore it
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _unraisable


def is_due() -> bool:
    """Whether an interrupt came where Python could not raise it, and has not been raised since."""
    return _is_due


def ignore() -> None:
    """Nothing is left to interrupt but the end itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Processes that are started meanwhile are never interrupted; an interrupt of this one waits for the end.

    A terminal interrupts all processes of a command, but one of them has to say what becomes of the others.
    """
    with deferred("SIGINT"), _blocked():
        yield


@contextmanager
def deferred(*names: str) -> Iterator[None]:
    """The signals with these names, as far as there are such and somebody heeds them, wait for the end."""
    arrived: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():  # only there can handlers be set
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
    """Children inherit that it is blocked in this thread; to us it may still come by way of another one."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # starting it would let interrupts through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """In a process of ``multiprocessing``: end once its parent has, however that came.

    With nobody left to ask for more it would wait for ever.
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


def _interrupt_again() -> None:
    global _is_due
    _is_due = True
    main = _thread.get_ident()  # only there are signals handled

    def after_a_while() -> None:
        time.sleep(_AGAIN_S)
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(main, signal.SIGINT)  # wakes it up if it waits for something
        else:
            _thread.interrupt_main()

    _thread.start_new_thread(after_a_while, ())


def _unraisable(raised: "UnraisableHookArgs", /) -> Any:
    if issubclass(raised.exc_type, KeyboardInterrupt):
        _interrupt_again()
    else:
        sys.__unraisablehook__(raised)


def _unraisable_after(raised: "UnraisableHookArgs", /) -> Any:
    """Objects that an interrupt has left half made fail once more as they go: that tells nobody anything."""
    if issubclass(raised.exc_type, KeyboardInterrupt):
        _interrupt_again()
