"""The workbench's server: address, access control, and validation of browsers' messages."""
