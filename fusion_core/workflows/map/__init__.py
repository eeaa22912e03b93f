"""``scanloom map``: motion, SLAM and maps of a recording (Li 2022; Fu 2024)."""
