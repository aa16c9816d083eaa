"""Recipes: what to put where, how it looks, what to write. Strict, frozen, read from YAML."""
