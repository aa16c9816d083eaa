"""InfraBlend: put rendered thermal objects into real thermal aerial images, with labels.

Importing this package imports neither Blender nor anything heavy; see `infrablend.api` for the functions
the command line calls.
"""

__version__ = "0.1.0"
