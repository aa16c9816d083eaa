"""Our alpha-over equals Blender's Alpha Over node up to rounding."""

import numpy as np
import OpenEXR

from infrablend.compositing.overlay import Layer, blend, compose

ALPHA_OVER = """
import bpy
import numpy as np

h, w = given["alpha"].shape

def picture(name, values, a):
    image = bpy.data.images.new(name, w, h, alpha=True, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "PREMUL"
    pixels = np.stack([values, values, values, a], axis=-1)[::-1].astype(np.float32)
    image.pixels.foreach_set(np.ascontiguousarray(pixels).ravel())
    return image

other = bpy.data.scenes.new("alpha_over")
try:
    other.use_nodes = True
    tree = other.node_tree
    tree.nodes.clear()
    under, over = tree.nodes.new("CompositorNodeImage"), tree.nodes.new("CompositorNodeImage")
    under.image = picture("under", given["background"] / np.float32(255), np.ones((h, w), np.float32))
    over.image = picture("over", given["grey"] / np.float32(255), given["alpha"])
    node = tree.nodes.new("CompositorNodeAlphaOver")
    node.premul = 0.0
    node.use_premultiply = False
    tree.links.new(under.outputs["Image"], node.inputs[1])
    tree.links.new(over.outputs["Image"], node.inputs[2])
    out = tree.nodes.new("CompositorNodeComposite")
    tree.links.new(node.outputs["Image"], out.inputs["Image"])
    r = other.render
    r.engine = "CYCLES"
    other.cycles.samples = 1
    r.resolution_x, r.resolution_y, r.resolution_percentage = w, h, 100
    r.use_compositing = True
    r.dither_intensity = 0
    other.view_settings.view_transform = "Raw"
    r.image_settings.file_format = "OPEN_EXR"
    r.image_settings.color_depth = "32"
    r.image_settings.exr_codec = "NONE"
    r.filepath = given["file"]
    camera = bpy.data.objects.new("c", bpy.data.cameras.new("c"))
    other.collection.objects.link(camera)
    other.camera = camera
    bpy.ops.render.render(write_still=True, scene=other.name)
finally:
    bpy.data.scenes.remove(other)
"""


def test_equals_the_alpha_over_node(blender, tmp_path):
    rng = np.random.default_rng(3)
    h, w = 24, 32
    background = rng.integers(16, 236, (h, w), dtype=np.uint8)
    alpha = rng.random((h, w), dtype=np.float32)
    alpha[rng.random((h, w)) < 0.3] = 0
    alpha[rng.random((h, w)) < 0.2] = 1
    grey = (rng.random((h, w), dtype=np.float32) * 219 + 16) * alpha
    file = tmp_path / "over.exr"
    blender.run(ALPHA_OVER, background=background, grey=grey, alpha=alpha, file=str(file))
    with OpenEXR.File(str(file), separate_channels=True) as exr:
        theirs = np.array(exr.channels()["R"].pixels, np.float32) * 255
    layer = Layer((0, 0), grey, alpha)
    assert np.abs(blend(background, layer) - theirs).max() < 1e-3
    assert (compose(background, layer) == np.rint(theirs).astype(np.uint8)).mean() > 0.995
    assert np.abs(compose(background, layer).astype(int) - np.rint(theirs)).max() <= 1
