"""Files of maps: places and areas as GeoJSON, KML and GPX, and sectors of a search."""
