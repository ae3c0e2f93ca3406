"""Peers: one module each; a peer that is not installed says so in one line."""
