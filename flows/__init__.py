"""The graph, its runners, the ready-made flows and the command line."""
