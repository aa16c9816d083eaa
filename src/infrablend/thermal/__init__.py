"""Thermal radiation in plain numpy: band radiance, sky and air. SI units and kelvin."""
