"""KIT1000: parts, kits that fit them, and angled assemblies of kits, for research on 6DoF kit assembly.

The public names stand in `__init__.pyi` and load on first use, so `import kit1000` takes almost no time.
"""

from __future__ import annotations

import lazy_loader

from kit1000.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
