"""``python -m contact_tracker`` is the command ``contact-tracker``."""

import sys

from contact_tracker.cli.main import run

sys.exit(run())
