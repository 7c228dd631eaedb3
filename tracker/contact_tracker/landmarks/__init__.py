"""Elements that are known beforehand or were seen before, and which of them are the same."""
