"""Object models to insert: people, animals, vehicles, aircraft, and a user's own; the thermal role of each part."""
