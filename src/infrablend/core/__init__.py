"""Domain types, geometry, ports and random streams: what every other part of InfraBlend speaks in."""
