"""The only place that composes stages: what the command line and the workbench call."""
