"""Finders of things whose size is a rule, one file a kind: painted courts, lane dashes, crossings, bays."""
