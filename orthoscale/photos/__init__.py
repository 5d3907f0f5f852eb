"""Single drone photos: their tags, their view of level ground, and the scale from their vehicles."""
