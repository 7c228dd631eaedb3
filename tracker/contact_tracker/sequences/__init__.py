"""A recording as a sequence of contacts: two takes compared, a plan followed, and the graph of contacts."""
