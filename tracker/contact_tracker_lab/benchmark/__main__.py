"""``python -m contact_tracker_lab.benchmark``; worker processes import ``benchmark``, not this."""

import sys

from contact_tracker_lab.benchmark.benchmark import main

if __name__ == "__main__":
    sys.exit(main())
