"""The slipflow command line."""
