#!/usr/bin/env python3
"""Writes the JPEG pictures next to this script. Needs: pip install pillow==13.0.0 numpy. Run in this folder.

All have 16 columns and 8 rows: grey.jpg the value 10 x + 5 y; colour.jpg and progressive.jpg red 200, green 12 x, blue 20 y.
"""

import numpy as np
from PIL import Image

y, x = np.mgrid[0:8, 0:16]
Image.fromarray((10 * x + 5 * y).astype(np.uint8)).save("grey.jpg", quality=92, optimize=True)
colour = Image.fromarray(np.stack([np.full((8, 16), 200), 12 * x, 20 * y], -1).astype(np.uint8))
colour.save("colour.jpg", quality=92, optimize=True, subsampling=0)
colour.save("progressive.jpg", quality=92, progressive=True, subsampling=0)
