"""How the camera moves through a sequence, from the background of its pictures."""
