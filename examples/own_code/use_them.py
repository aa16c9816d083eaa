"""Compose frames in memory with a sampler, backgrounds and a look of your own.

    python examples/own_code/use_them.py [--renderer flat]

The classes are in a module of their own, because worker processes import them by name.
"""

import argparse

from extensions import DeadPixels, Gradients, OneObject

from infrablend import api

parser = argparse.ArgumentParser()
parser.add_argument("--renderer", default="blender", help="flat needs no Blender")
options = parser.parse_args()

settings = {"objects.0.count": 3, "configurations": 1}
extensions = api.Extensions(sampler=OneObject(), look=DeadPixels())
execution = api.Execution(workers=2, renderer=options.renderer)
with api.frames("hit-uav-drone", Gradients(), settings=settings, extensions=extensions, execution=execution) as frames:
    for frame in frames:
        boxes = [[round(float(v)) for v in label.box_xyxy] for label in frame.inserted]
        print(frame.id, frame.pixels.shape, boxes, "dead pixels:", int((frame.pixels == 0).sum()))
