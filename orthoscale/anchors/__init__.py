"""Finders of things whose size is a rule: painted courts, lane dashes, crossings, bays, rails, containers."""
