"""Contacts beside the first: pairs of elements that touch at the same time (docs/theory.md, section 18)."""
