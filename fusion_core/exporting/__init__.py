"""Results to files: tables, maps, figures, point clouds, manifest; every file atomically."""
