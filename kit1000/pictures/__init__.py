"""Pictures of depth images, masks, parts, kits, assemblies and scenes."""
