"""Physics of a thermal camera's view in plain numpy: radiance, surfaces, sky and air. SI units and kelvin."""
