"""Pure operators over typed batches: no I/O, no clock, no event loop."""
