"""The command, as the program ``contact-tracker`` and as ``python -m contact_tracker``.

From the first line of this file on, an interrupt ends it without a traceback: other modules are imported
later, and ``_signal`` and ``sys`` are parts of the interpreter.
"""

import _signal  # type: ignore[import-not-found]
import os
import sys

INTERRUPTED = 130
"""Exit code, as in ``errors.py``, which would have to be imported first."""


def _end_at_once(*_: object) -> None:
    """End the process, which has not begun anything yet."""
    os._exit(INTERRUPTED)


try:
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:  # background jobs ignore it
        _signal.signal(_signal.SIGINT, _end_at_once)
except ValueError:  # this is not the main thread
    pass


def main() -> int:
    """Run the command line and return its exit code."""
    try:
        import contact_tracker.interrupts as interrupts

        if _signal.getsignal(_signal.SIGINT) is _end_at_once:
            _signal.signal(_signal.SIGINT, _signal.default_int_handler)
        interrupts.end_in_order("SIGINT")
        try:
            from contact_tracker.cli.main import run

            return run()
        except Exception:
            if interrupts.is_due():  # the interrupted code went on with half a result
                return INTERRUPTED
            raise
        finally:
            _signal.signal(_signal.SIGINT, _signal.SIG_IGN)
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
