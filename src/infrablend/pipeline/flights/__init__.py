"""Flights: what a detector finds in them, where that is, and how likely something was missed."""
