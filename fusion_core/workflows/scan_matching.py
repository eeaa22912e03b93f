"""Two sweeps of a 2D LiDAR matched without a recording: PL-ICP on plain arrays (Censi 2008)."""

from fusion_core.registration.pl_icp import ScanMatch, match_scans

__all__ = ["ScanMatch", "match_scans"]
