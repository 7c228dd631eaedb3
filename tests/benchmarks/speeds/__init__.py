"""What speed.py measures, a file for each row of its table."""
