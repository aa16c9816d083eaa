"""A local page in the browser: review the frames of a run, tune a recipe, compare, and read results.

The state of a page lives in modules that know nothing of widgets; `*_page` modules show it with NiceGUI, which is an
extra. All truth is in files: a page can be closed or the server killed at any moment.
"""
