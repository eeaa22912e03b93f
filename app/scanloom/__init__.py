"""The command line and the workbench: no algorithms."""
