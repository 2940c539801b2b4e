"""Poses of shapes whose meshes are known, in a depth image: analysis by synthesis of the disparity image.

Read it in the order of the method: `predictor` (query and shapes in, a motion out), `several_images` (one pose for all
images of a part), `registration` (all shapes of a scene), `scene_search` (where they stand together), `height_search`
(where a shape may be), `fit` (where it is), `disparity` (what a sensor makes of it), `shapes`.
"""

from kit1000.prediction.catalog import Method

METHODS = {
    "registration-known": Method(
        "kit1000.known_shapes.predictor:KnownShapeRegistration",
        "the known shapes of parts and kits are registered to the depth image, and the insertion follows from them",
        label="Registration, known shapes",
        reads="shapes",
    ),
}
