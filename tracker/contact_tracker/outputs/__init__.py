"""Formatting of beliefs, segments and summaries as text and JSON."""
