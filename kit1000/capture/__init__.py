"""A scene from the user's own depth camera: `kit1000 import`.

Read it in the order of the work: `intrinsics` and `camera_files` (of which pixels), `depth_frames` (one frame and its
unit, the median of several), `depth_files` and `recordings` (which frames), `pinhole_images` (one image without
distortion, at the focal length that perception knows), `table_search` (the plane z = 0), `seen_bodies` (what stands on
it), `mask_networks` (their outlines), `own_world` (the world's axes), `own_scene` (all of it), `known_sensors`,
`scene_report` (sizes to check with a ruler), `own_folder` (a dataset folder), `importing` (from the first file to the
folder).
"""
