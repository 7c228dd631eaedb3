"""Sequences of contacts: comparison of two takes, following a plan, and the graph of contacts."""
