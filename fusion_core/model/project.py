"""The project's own name and version, as files that it writes have them."""

from importlib.metadata import PackageNotFoundError, version

PROJECT = "scanloom"


def project_version() -> str:
    """The installed version, "0+not-installed" of a source tree that is not installed."""
    try:
        return version(PROJECT)
    except PackageNotFoundError:
        return "0+not-installed"
