"""Small sets of maps."""

import numpy as np
from PIL import Image

UP = (128, 128, 255)  # a flat normal


def written(folder, **images):
    """PNG files of these numbers of 255: a grey level, or a colour."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in images.items():
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(folder / f"{name}.png")
    return folder
