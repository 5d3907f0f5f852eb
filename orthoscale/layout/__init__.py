"""Standard facilities placed on an orthophoto that has its metres, and drawn there to the pixel."""
