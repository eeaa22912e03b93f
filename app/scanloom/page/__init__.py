"""The page beyond viser's widgets: its script, pictures that answer to the pointer, its layout."""
