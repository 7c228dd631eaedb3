"""The command, as the program ``contact-tracker`` and as ``python -m contact_tracker``.

An interrupt ends it without a traceback: all is imported where that is caught.
"""

import sys

INTERRUPTED = 130
"""As in ``errors.py``, which would have to be imported first."""


def main() -> int:
    """Run the command line and return its exit code."""
    try:
        import signal

        from contact_tracker import interrupts

        interrupts.end_in_order("SIGINT")
        try:
            from contact_tracker.cli.main import run

            return run()
        except Exception:
            if interrupts.is_interrupted():
                return INTERRUPTED
            raise
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
