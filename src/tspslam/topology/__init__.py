"""Points and an image to a complex, signals on its vertices, edges and faces, and their harmonic response."""
