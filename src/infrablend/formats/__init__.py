"""Dataset formats: each one file that reads it, writes it and counts what it cannot hold."""
