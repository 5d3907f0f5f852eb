"""Files derived from a model, scaled to metres: point clouds, meshes, splats, camera files, dense workspaces."""
