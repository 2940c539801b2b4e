"""A scene from the user's own depth camera: `kit1000 import`.

Read it in the order of the work: `intrinsics` and `camera_files` (whose pixels), `depth_files`, `ros_bags` and
`foxglove_topics` (depth as others store it), `frame_average`, `pinhole_images` (one depth image, without distortion,
at the focal length that perception knows), `table_search` (the plane z = 0), `seen_bodies` (what stands on it),
`own_world` (the world's axes), `mask_networks` (masks cut back), `own_scene` (all of it), `own_folder` (a dataset folder).
"""
