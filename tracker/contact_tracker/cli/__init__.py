"""The command ``contact-tracker``: options in ``commands``, work in a module each, exit codes in ``main``."""
