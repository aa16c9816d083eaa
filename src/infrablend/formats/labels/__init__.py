"""Formats that people label and train with: each detects, reads and writes one of them."""
