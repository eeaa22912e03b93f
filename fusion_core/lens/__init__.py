"""The lens of a camera, by OpenCV's models: points to pixels, pixels to rays, straight images."""
