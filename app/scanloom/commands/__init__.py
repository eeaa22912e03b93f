"""The command line: its subcommands, their options, and what they print."""
