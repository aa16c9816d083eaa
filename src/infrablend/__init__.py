"""InfraBlend: insert rendered thermal objects into real thermal aerial images, with labels.

    import infrablend

    report = infrablend.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)

`infrablend.api` has the other functions. Importing this package loads neither Blender nor NumPy: each name is loaded
on first use.
"""

from infrablend.core.lazy_names import lazy_names

__version__ = "0.2.0"

__getattr__, __dir__, _names = lazy_names(__name__, __file__)
__all__ = [*_names, "__version__"]
