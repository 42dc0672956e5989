"""Linear least squares: triangles of information, what they show and what they do not."""
