"""The commands of this package, one a file; pyproject.toml names each, imported when called."""
