"""Results to files: tables, maps, MCAP, manifest. Everything is written aside and renamed."""
