"""Where on a map a picture was taken: cross-view localisation at the scale that vehicles give."""
