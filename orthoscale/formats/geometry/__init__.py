"""What is handed on beside a model, in metres: point clouds, meshes, splats, camera files, dense workspaces."""
