"""Domain types, geometry, ports and random streams that all other packages share."""
