"""Remotes: frame decoders and what their sticks and buttons mean."""
