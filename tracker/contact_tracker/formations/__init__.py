"""Contacts beside the first: several pairs of elements that touch at the same time (docs/theory.md, section 18)."""
