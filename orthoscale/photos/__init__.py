"""Single photos of a drone: what their tags say, how they see level ground, and what their vehicles make of it."""
