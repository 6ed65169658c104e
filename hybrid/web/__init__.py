"""The page of `straightlens serve`: drop a picture, look at it straight, take lens and picture."""
