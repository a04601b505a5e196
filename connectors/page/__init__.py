"""The live page: what a flow feels, in a browser."""
