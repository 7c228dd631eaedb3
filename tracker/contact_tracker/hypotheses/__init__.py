"""The hypothesis banks of the contacts: birth, fit, evidence, search and pruning."""
