"""Runs: making the frames of a plan, the ledger and its exports, shards, merging, excluding, rendering again."""
