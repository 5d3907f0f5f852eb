"""Finders of things of standard size, one file a kind."""
