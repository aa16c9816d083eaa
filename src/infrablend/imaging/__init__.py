"""What a background shows, from its pixels: surfaces, sky, burnt-in text, margins, and how the camera moved."""
