"""Song 2022 §2.2: features of an intensity image and of a camera's image, to extrinsics."""
