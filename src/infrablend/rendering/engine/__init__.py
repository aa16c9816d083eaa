"""Blender in a process of its own: found (`programs`), installed (`install`), started and asked (`process`).

`renderer` and `world` have it render scenes, `importer` read 3D files, `shader` write the node groups; `turntable`
draws a sheet of a model. The other side is `infrablend.blender`, which no module here imports.
"""
