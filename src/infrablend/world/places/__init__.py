"""The places a scene can show; each function fills a `Site` and names the material of the open ground."""
