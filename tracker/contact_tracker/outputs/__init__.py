"""How beliefs, segments and summaries are written: pure formatting."""
