"""Attacks on the command line: kills, broken inputs and bad surroundings; `scripts/attack.py` runs them in number."""
