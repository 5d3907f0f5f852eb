"""Cross-view localisation: where on a map a picture was taken, at the scale given by its vehicles."""
