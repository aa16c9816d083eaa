"""Telling inserted objects from real ones: measurements, controls, classifiers. Pictures in, numbers out."""
