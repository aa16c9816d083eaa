"""Object models to insert: procedural car, drone, deer and person, and a user's own; the thermal role of each part."""
