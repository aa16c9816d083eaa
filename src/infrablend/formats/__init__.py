"""Dataset formats: each one file or package that reads it, writes it and counts what it cannot hold."""
