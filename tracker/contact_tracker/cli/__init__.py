"""The command ``contact-tracker``: one file per subcommand, exit codes in ``main``."""
