"""Inner products of surface currents: integrals of the kernel over pairs of segments or triangles."""
