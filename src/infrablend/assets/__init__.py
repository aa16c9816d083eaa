"""Object models to insert: procedural people, animals, vehicles and aircraft, and a user's own; the thermal role of each part."""
