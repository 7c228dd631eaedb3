"""The command, as the program ``contact-tracker`` and as ``python -m contact_tracker``.

An interrupt ends it without a traceback as soon as ``main`` runs: all else is imported in it.
"""

import sys

INTERRUPTED = 130
"""As in ``exit_codes.py``, which would have to be imported first."""


def main() -> int:
    """Run the command line and return its exit code."""
    try:
        from contact_tracker import interrupts

        interrupts.end_in_order("SIGINT")
        try:
            from contact_tracker.cli.main import run

            return run()
        except Exception:
            if interrupts.has_come():  # what it was raised in went on with half a result
                return INTERRUPTED
            raise
        finally:
            interrupts.ignore("SIGINT")
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
