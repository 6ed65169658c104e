"""Networks that see bent lines and the lens that bent them; import from the modules."""
