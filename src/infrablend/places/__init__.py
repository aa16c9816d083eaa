"""Maps of places: what lies at each pixel of a background, and where objects can stand and drive."""
