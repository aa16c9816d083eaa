"""Data that is elsewhere: downloads of datasets, their archives, and object storage."""
