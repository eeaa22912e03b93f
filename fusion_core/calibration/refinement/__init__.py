"""A guess refined by one cloud and one image, with evidence that was held out."""
