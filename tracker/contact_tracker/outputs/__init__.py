"""What is written: pure formatting, and files that appear whole or not at all."""
