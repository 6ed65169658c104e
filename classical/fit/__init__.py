"""The straightness fit: curves in, lens out."""

import lazy_loader

# names of __init__.pyi, imported when used: results name curves of a fit without loading SciPy
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
