"""Standard facilities placed on an orthophoto of known scale, and drawn there to the pixel."""
