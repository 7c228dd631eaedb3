"""Results as files and objects of other programs: tables, figures, reports, Foxglove, subtitles.

Libraries that only some of them need are imported where they are used, and come with extras.
"""
