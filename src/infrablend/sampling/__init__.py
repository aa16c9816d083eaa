"""From a background, a recipe and a seed to a scene: all randomness of a frame is here."""
