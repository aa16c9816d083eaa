"""Formats that people label and train with: one file each, which detects, reads and writes it."""
