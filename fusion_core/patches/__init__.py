"""Small plane patches of depth images: points of surfaces with normals, and the up they show."""
