"""Parameters of the tracker, and the TOML files that have them."""
