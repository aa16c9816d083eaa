"""Recipes for tests on made-up backgrounds: noise and stripes show no surface that the model of surfaces could know."""

from infrablend.config.loading import load_recipe

ANYWHERE = "placement.where=anywhere"


def load_anywhere(name, settings=()):
    """Return a shipped recipe of metric placement whose objects stand anywhere."""
    return load_recipe(name, [ANYWHERE, *settings])
