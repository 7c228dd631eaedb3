"""Export of results: tables, figures, reports, Foxglove, subtitles.

Optional libraries are imported where they are used, and installed by extras.
"""
