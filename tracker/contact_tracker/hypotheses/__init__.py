"""The hypotheses of each contact: how they begin, are fitted, weighed and dropped."""
