"""Object models: shapes built from numbers, and the thermal role of each of their parts."""
