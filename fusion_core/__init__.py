"""ScanLoom's stages: pure functions from frozen inputs and settings to frozen results."""

__version__ = "0.1.0"
