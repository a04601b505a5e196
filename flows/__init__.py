"""Ready-made flows, the graph, its runners and the command line."""
