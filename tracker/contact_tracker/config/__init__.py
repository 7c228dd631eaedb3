"""Parameters of the tracker, and their TOML files."""
