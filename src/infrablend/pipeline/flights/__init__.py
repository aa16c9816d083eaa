"""Answers about a flight: what a detector finds in its pictures."""
