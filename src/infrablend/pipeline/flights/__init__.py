"""Answers about a flight: what its pictures show, and where."""
