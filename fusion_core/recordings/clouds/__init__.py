"""Files with one point cloud: PCD, PLY and KITTI's .bin."""
