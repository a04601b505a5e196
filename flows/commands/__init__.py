"""The command line: what it takes, what it tells, what it exits with."""
