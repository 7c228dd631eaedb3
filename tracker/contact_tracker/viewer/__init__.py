"""The viewer: what is believed, drawn with rerun into its window or into a file.

Importing this package costs nothing; ``offline`` and ``live`` import rerun. Whoever shows a live view only
when asked takes ``absent`` otherwise.
"""
