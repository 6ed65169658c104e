"""Classical geometry: cameras, warps, curves in pictures and the fit that makes them straight."""
