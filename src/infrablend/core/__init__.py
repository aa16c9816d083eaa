"""Domain types, geometry, interfaces, file handling and random streams that all other packages share."""
