"""Filters whose ticks and noise are adapted to the stream: multiple-model estimation (docs/theory.md)."""
