"""The generator that the settings ask for."""

from __future__ import annotations

from torch import nn

from ...errors import ConfigError
from ..checkpoint import load_module_state, load_tensors, part
from ..gan_config import GanConfig
from ..parameters import Streams
from .networks import AllPhotosGenerator, TwoStreamGenerator, seeded

Generator = AllPhotosGenerator | TwoStreamGenerator


def make_generator(config: GanConfig, streams: Streams, inputs: int) -> Generator:
    """A generator with the weights of its seed, or of the pretrained checkpoint.

    Args:
        config: its kind and size.
        streams: the channels of the maps to fit.
        inputs: channels of the conditioning image, for a generator of all photos.

    Raises:
        ConfigError: the pretrained checkpoint is of another size or kind.
    """
    change = config.begins != "untrained"
    with seeded(config.seed):
        generator: Generator
        if config.generator == "two-stream":
            generator = TwoStreamGenerator(streams, config.width, change)
        else:
            generator = AllPhotosGenerator(inputs, streams, config.width, change)
    if config.pretrained:
        load_generator(generator, config, config.pretrained)
    return generator


def load_generator(generator: nn.Module, config: GanConfig, path: str) -> None:
    """Fill a generator from a checkpoint of ``mitsvbrdf fit --pretrain`` or of a ``gan`` fit.

    Raises:
        ConfigError: no checkpoint, or one of another width or parameter set.
    """
    tensors, note = load_tensors(path)
    try:
        load_module_state("generator", generator, part(tensors, "method."))
    except RuntimeError:
        raise ConfigError(f"a generator of width {config.width} for {config.bsdf}",
                          f"another one in {path} (bsdf {note.get('bsdf')})",
                          "use the --width, --bsdf, --generator, --fix and --grey-specular it was pretrained "
                          "with") from None
