"""What is read back of previews."""

import numpy as np

from mitsvbrdf.errors import MitsvbrdfError
from mitsvbrdf.io import images


def srgb(x):
    x = np.asarray(x, dtype=np.float64)
    return np.clip(np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055), 0,
                   1)


def pictures(out, preset):
    return [images.read_image(path, MitsvbrdfError) for path in sorted((out / preset).glob("*.exr"))]
